"""The bytes of a dataset by processes and by clusters, with kills and without: one hash."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path
from typing import Any

from neuroanimator import DatasetConfig, generate
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.executor.ray_cluster import RayExecutor
from scale_cases.nodes import cluster_of, node_killed

TRANSITIONS = 120_000
"""Fourteen shards of the pendulum."""

QUICK_TRANSITIONS = 40_000


def measure(work: Path, is_quick: bool) -> list[dict[str, Any]]:
    """Return a row for each way to make one dataset; all hashes must be the same."""
    count = QUICK_TRANSITIONS if is_quick else TRANSITIONS
    config = DatasetConfig(system="pendulum", count=count, samples_per_run=36)
    made = _Made(config, work / "bytes")
    rows = [
        made.row("local, 1 process", LocalExecutor(1)),
        made.row("local, 2 processes", LocalExecutor(2)),
    ]
    with RayExecutor(None, 2) as ray:
        rows.append(made.row("Ray, 1 node", ray))
    with cluster_of(4) as (_, ray):
        rows.append(made.row("Ray, 4 nodes", ray))
    with cluster_of(4) as (cluster, ray), node_killed(cluster) as done:
        rows.append(made.row("Ray, 4 nodes", ray, done))
    hashes = {row["sha256"] for row in rows}
    assert len(hashes) == 1, hashes
    return rows


class _Made:
    """One dataset, made again and again."""

    def __init__(self, config: DatasetConfig, work: Path):
        self.config = config
        self.work = work

    def row(self, where: str, executor: Any, done: list[str] | None = None) -> dict[str, Any]:
        """Make it by `executor`; `done` fills with what happened meanwhile."""
        shutil.rmtree(self.work, ignore_errors=True)
        with executor:
            generate(self.config, self.work, executor=executor)
        total = hashlib.sha256()
        for path in sorted(self.work.glob("*.*s*")):
            total.update(path.name.encode())
            total.update(path.read_bytes())
        return {
            "where": where,
            "meanwhile": ", ".join(done or []) or "nothing",
            "shards": self.config.shards,
            "sha256": total.hexdigest(),
        }
