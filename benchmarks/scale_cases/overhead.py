"""What Ray takes beside processes of this machine: tasks of 10 ms to 10 s, and shards of the usual size."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator import DatasetConfig, generate
from neuroanimator.executor.cores import core_count
from neuroanimator.executor.executor import Executor
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.executor.ray_cluster import RayExecutor
from scale_cases.nodes import busy

COUNTS = {0.01: 1000, 0.1: 200, 1.0: 20, 10.0: 4}
"""Number of tasks of each length [s]."""

QUICK_COUNTS = {0.01: 100, 0.1: 20}

SHARDS = 16
"""Number of shards of the pendulum, 256 runs each as always."""

QUICK_SHARDS = 2

ROUNDS = 5
"""Number of turns of both sides, one after the other; medians count."""


@dataclass(frozen=True)
class Spin:
    """A task that does nothing but use a processor."""

    number: int
    seconds: float

    @property
    def label(self) -> str:
        return f"task {self.number}"


def spin(task: Spin) -> int:
    """Return the task's number after so much work."""
    busy(task.seconds)
    return task.number


def measure(work: Path, is_quick: bool) -> list[dict[str, Any]]:
    """Return a row for each length of tasks, and one for shards: seconds by processes, by Ray, and Ray's share on top."""
    workers = core_count()
    rounds = 1 if is_quick else ROUNDS
    rows = []
    with LocalExecutor(workers) as local, RayExecutor(None, workers) as ray:
        sides: dict[str, Executor] = {"local": local, "ray": ray}
        for seconds, count in (QUICK_COUNTS if is_quick else COUNTS).items():
            tasks = [Spin(number, seconds) for number in range(count)]

            def spread(executor: Executor, tasks: list[Spin] = tasks) -> None:
                executor.map(spin, tasks)

            rows.append(_row(f"{seconds:g} s", count, sides, spread, rounds))
        shards = QUICK_SHARDS if is_quick else SHARDS
        config = DatasetConfig(system="pendulum", count=36 * 256 * shards, samples_per_run=36)
        folder = work / "overhead"

        def make(executor: Executor) -> None:
            shutil.rmtree(folder, ignore_errors=True)
            generate(config, folder, executor=executor)

        rows.append(_row("a shard", config.shards, sides, make, rounds))
    return rows


def _row(
    task: str,
    count: int,
    sides: dict[str, Executor],
    work: Callable[[Executor], None],
    rounds: int,
) -> dict[str, Any]:
    seconds: dict[str, list[float]] = {name: [] for name in sides}
    for executor in sides.values():
        executor.map(spin, [Spin(0, 0.5), Spin(1, 0.5)])  # workers start
    for _ in range(rounds):
        for name, executor in sides.items():
            began = time.perf_counter()
            work(executor)
            seconds[name].append(time.perf_counter() - began)
    local = float(np.median(seconds["local"]))
    ray = float(np.median(seconds["ray"]))
    return {
        "task": task,
        "tasks": count,
        "workers": sides["local"].workers,
        "local_seconds": local,
        "ray_seconds": ray,
        "overhead": ray / local - 1,
    }
