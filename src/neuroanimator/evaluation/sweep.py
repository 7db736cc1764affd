"""Which n: emulators of several super steps, trained on equal budgets and compared after equal time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import generate
from neuroanimator.data.store import read_transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.evaluation.accuracy import one_step_error, rollout_error, root_mean_square
from neuroanimator.evaluation.held_out import held_out_runs
from neuroanimator.evaluation.speed import measure_emulator
from neuroanimator.systems.loading import resolve
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.train import train

TEST_RUNS = 24
"""Each n is tested on so many unseen runs."""


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
    on_row: Callable[[], None] = lambda: None,
) -> list[SweepRow]:
    """Return one row per n in `counts` for the system `reference` names; data and emulators are kept in `out`.

    Every n gets the same number of transitions and of updates. Errors are compared after `seconds` [s].
    """
    name, definition, _ = resolve(reference)
    rows = []
    for substeps in sorted(set(counts)):
        config = DatasetConfig(
            system=name, definition=definition, substeps=substeps, count=transitions
        )
        folder = out / f"{name}-{substeps}"
        path = out / f"{name}-{substeps}.emulator.safetensors"
        generate(config, folder)
        emulator = train(read_transitions(folder), TrainingConfig(updates=updates), path)
        rows.append(_measured(emulator, seconds, path))
        on_row()
    return rows


def _measured(emulator: Emulator, seconds: float, path: Path) -> SweepRow:
    test = held_out_runs(emulator, count=TEST_RUNS, seconds=max(seconds, emulator.dt))
    emulated = emulator.rollout(test.states[:, 0], test.controls, may_diverge=True)
    errors = rollout_error(test.frame, np.asarray(emulated, float), test.states)
    return SweepRow(
        substeps=emulator.substeps,
        one_step_error=float(root_mean_square(one_step_error(emulator, test))),
        error=float(errors[-1]),
        us_per_second=measure_emulator(emulator) * 1e6 / emulator.dt,
        path=path,
    )


def largest_within(rows: list[SweepRow], tolerance: float) -> SweepRow | None:
    """Return the row of the largest n whose error is at most `tolerance`, or None."""
    if not 0 < tolerance < float("inf"):
        raise ArgumentError(f"tolerance: wanted a positive number, came {tolerance:g}.")
    within = [row for row in rows if row.error <= tolerance]
    return max(within, key=lambda row: row.substeps, default=None)
