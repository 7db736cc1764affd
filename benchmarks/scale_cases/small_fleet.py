"""A fleet of 24 small trainings on four nodes, one of which is killed: 24 emulators, one table."""

from __future__ import annotations

import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

from neuroanimator.evaluation.fleets.fleet_file import Fleet, read_fleet
from neuroanimator.evaluation.fleets.train_fleet import FleetRow, train_fleet
from neuroanimator.executor.local import LocalExecutor
from scale_cases.nodes import cluster_of, node_killed

FLEET = """
systems = ["pendulum", "truck"]
substeps = [25, 50]
seeds = [0, 1, 2]
count = 1_800
[sizes.small]
widths = [8]
updates = 250
[sizes.large]
widths = [32, 16]
updates = 250
"""

EVERY = 5
"""Number of emulators of which one is made by one process, too."""

QUICK_FLEET = FLEET.replace(', "truck"', "").replace("[25, 50]", "[50]")


def measure(work: Path, is_quick: bool) -> list[dict[str, Any]]:
    """Return a row for each emulator, as the fleet's table has it, and whether one process makes the same bytes."""
    folder = work / "fleet"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    file = folder / "fleet.toml"
    file.write_text(QUICK_FLEET if is_quick else FLEET)
    fleet = read_fleet(file)
    with cluster_of(4) as (cluster, executor), node_killed(cluster) as done:
        rows = train_fleet(fleet, folder / "ray", executor)
    some = Fleet(fleet.members[::EVERY], fleet.data)
    with LocalExecutor(1) as alone:
        expected = {row.name: row for row in train_fleet(some, folder / "alone", alone)}
    files = list((folder / "ray").glob("*.emulator.safetensors"))
    assert len(files) == len(rows) == len(fleet.members)
    assert done[:1] == ["a node killed"], done
    for name, row in expected.items():
        assert row.sha256 == next(other.sha256 for other in rows if other.name == name)
    return [_row(row, row.name in expected, done) for row in rows]


def _row(row: FleetRow, is_compared: bool, done: list[str]) -> dict[str, Any]:
    same = "same bytes" if is_compared else "not made"
    return asdict(row) | {"meanwhile": ", ".join(done), "by_one_process": same}
