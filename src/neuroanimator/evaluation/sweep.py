"""Which n: emulators of several super steps, trained on equal budgets and compared after equal time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from neuroanimator.cores import core_count
from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import generate
from neuroanimator.data.stored import open_transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.evaluation.accuracy import unseen_errors
from neuroanimator.evaluation.held_out import held_out_runs
from neuroanimator.evaluation.speed import measure_emulator
from neuroanimator.executor.executor import Executor
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.storage.files import write_whole
from neuroanimator.storage.unfinished import temporary_folder
from neuroanimator.systems.loading import resolve
from neuroanimator.systems.trusted_files import TrustedFiles, trust_as_told, trusted_so_far
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.train import train

TEST_RUNS = 24
"""Number of unseen runs on which each n is tested."""


@dataclass(frozen=True)
class SweepTask:
    """One n of a sweep."""

    data: DatasetConfig
    training: TrainingConfig
    seconds: float
    """Time after which the error is measured [s]."""
    dataset: str
    """Folder of its dataset, if the worker sees this disk; empty if it makes its own."""
    path: str
    """The emulator's file, likewise."""
    trusted: TrustedFiles
    """The files that the process which gives the task may use."""

    @property
    def label(self) -> str:
        """Its name in error messages."""
        return f"n = {self.data.substeps}"


class Swept(NamedTuple):
    """What came of one n."""

    content: bytes
    """The emulator's file."""
    one_step_error: float
    error: float


@dataclass(frozen=True)
class SweepRow:
    """One n of a sweep."""

    substeps: int
    one_step_error: float
    error: float
    """Rollout error after the time asked for."""
    us_per_second: float
    """Time one simulated second takes [µs]."""
    path: Path
    """The emulator's file."""


def sweep(
    reference: str,
    counts: Sequence[int],
    out: Path,
    *,
    seconds: float,
    transitions: int,
    updates: int,
    executor: Executor | None = None,
    on_row: Callable[[], None] = lambda: None,
) -> list[SweepRow]:
    """Return one row per n in `counts` for the system `reference` names; data and emulators are kept in `out`.

    Every n gets the same number of transitions and of updates. Errors are compared after `seconds` [s]. The `executor`
    trains them; times are measured here, one after the other, when nothing else is computed.
    """
    name, definition, _ = resolve(reference)
    executor = executor or LocalExecutor(1, core_count())
    tasks = []
    for substeps in sorted(set(counts)):
        config = DatasetConfig(
            system=name, definition=definition, substeps=substeps, count=transitions
        )
        dataset = out / f"{name}-{substeps}"
        generate(config, dataset, executor=executor)
        path = _path(out, config)
        seen = executor.shares_disk
        task = SweepTask(
            data=config,
            training=TrainingConfig(updates=updates),
            seconds=seconds,
            dataset=str(dataset.resolve()) if seen else "",
            path=str(path.resolve()) if seen else "",
            trusted=trusted_so_far(),
        )
        tasks.append(task)
    found = executor.map(run_sweep_task, tasks, on_done=lambda outcome: on_row())
    rows = []
    for task, swept in zip(tasks, found, strict=True):
        path = _path(out, task.data)
        write_whole(path, swept.content)
        rows.append(_timed(Emulator.load(path), swept, path))
    return rows


def _path(out: Path, config: DatasetConfig) -> Path:
    return out / f"{config.system}-{config.substeps}.emulator.safetensors"


def run_sweep_task(task: SweepTask) -> Swept:
    """Return the emulator of one n and its errors: a function of the task alone."""
    trust_as_told(task.trusted)
    with temporary_folder() as folder:
        dataset = Path(task.dataset or f"{folder}/data")
        path = Path(task.path or f"{folder}/e.emulator.safetensors")
        if not task.dataset:
            generate(task.data, dataset)
        data = open_transitions(dataset, task.training.memory)
        emulator = train(data, task.training, path)
        seconds = max(task.seconds, emulator.dt)
        test = held_out_runs(emulator, count=TEST_RUNS, seconds=seconds)
        one_step, error = unseen_errors(emulator, test, seconds)
        return Swept(path.read_bytes(), one_step, error)


def _timed(emulator: Emulator, swept: Swept, path: Path) -> SweepRow:
    return SweepRow(
        substeps=emulator.substeps,
        one_step_error=swept.one_step_error,
        error=swept.error,
        us_per_second=measure_emulator(emulator) * 1e6 / emulator.dt,
        path=path,
    )


def largest_within(rows: list[SweepRow], tolerance: float) -> SweepRow | None:
    """Return the row of the largest n whose error is at most `tolerance`, or None."""
    if not 0 < tolerance < float("inf"):
        raise ArgumentError(f"tolerance: wanted a positive number, came {tolerance:g}.")
    within = [row for row in rows if row.error <= tolerance]
    return max(within, key=lambda row: row.substeps, default=None)
