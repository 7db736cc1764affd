"""Train an emulator on with a recording of the real system, among old windows so that it keeps what it knew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neuroanimator.data.config import MAX_UNROLL, DatasetConfig
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.evaluation.held_out import make_test, recorded_runs, system_of
from neuroanimator.evaluation.weakness.config import ImprovementConfig
from neuroanimator.evaluation.weakness.improve import (
    ErrorChange,
    error_changes,
    errors_by_test,
    fresh_data,
    usual_test,
)
from neuroanimator.evaluation.weakness.learning import mix_windows, train_on
from neuroanimator.evaluation.weakness.recordings import RecordedRuns, read_runs
from neuroanimator.evaluation.weakness.sampling import Runs, join_runs
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase
from neuroanimator.training.train import Report

TAIL = 0.2
"""Share at the end of each run that is kept for the test."""

RECORDED_SHARE = 0.5
"""Share of recorded windows among those learnt from: larger than that of simulated ones, as they contradict the old."""

MIN_WINDOWS = 100
"""Minimum number of windows to learn from: fewer teach nothing that lasts."""

MAX_WINDOWS = 100_000
"""Maximum number of windows that are learnt from, evenly taken."""

MAX_TESTED = 8_000
"""Maximum number of super steps that are tested, evenly taken."""

BLOCK = 8
"""Number of super steps within which windows begin that are validated on together, or learnt from together: they overlap."""


@dataclass(frozen=True)
class FineTuning:
    """The result of learning from a recording: the new emulator, and errors before and after."""

    emulator: Emulator
    errors: tuple[ErrorChange, ...]
    """On the recording's tail, which was not learnt from, and on usual motions where there is a test of these."""
    windows: int
    """Windows of the recording that were learnt from."""
    has_old: bool
    """Whether old windows were among what was learnt."""


def fine_tune(
    emulator: Emulator,
    recording: str | Path,
    out: str | Path,
    *,
    config: ImprovementConfig | None = None,
    data: Transitions | None = None,
    on_report: Callable[[Report], None] = lambda report: None,
) -> FineTuning:
    """Train `emulator` on with a recording (CSV or NPZ), write it to `out` and return it with its errors before and after.

    The last fifth of each run is its test and never learnt from. Half of what is learnt are old windows: those of
    `data`, or simulated anew where the system can be. Nothing is simulated besides; of `config` only the updates, the
    windows and the seed count. A run found in `run_folder(out)` is continued.

    Raises BadFileError naming the line of a recording that is wrong, and for one that is too short.
    """
    config = config or ImprovementConfig()
    system = system_of(emulator)
    learning, tail = split(read_runs(recording, emulator))
    tests = {str(recording): make_test(system, emulator.dt, tail.states, tail.controls)}
    if data is None and system.can_simulate:
        data = fresh_data(emulator, config)
    if system.can_simulate:
        with phase("simulating tests"):
            tests["usual"] = usual_test(emulator, system, config.seed)
    elif data is not None:
        tests["usual"] = recorded_runs(emulator, data)
    before = errors_by_test(emulator, tests)
    if data is None:
        windows = mix_windows(_no_data(emulator, system, learning), learning, config, new_share=1.0)
    else:
        windows = mix_windows(data, learning, config, RECORDED_SHARE)
    trained = train_on(emulator, learning, windows, Path(out), config, on_report)
    errors = error_changes(before, errors_by_test(trained, tests))
    return FineTuning(trained, errors, len(learning.states), data is not None)


def _no_data(emulator: Emulator, system: System, like: Runs) -> Transitions:
    """Return an empty dataset, in place of that of an emulator whose own is not at hand."""
    dataset = DatasetConfig(
        system=emulator.system, definition=emulator.definition, substeps=emulator.substeps
    )
    return Transitions(dataset, system, *like.rows(np.arange(0)), diverged=0)


def split(runs: RecordedRuns) -> tuple[Runs, Runs]:
    """Return (windows to learn from, super steps to test on).

    These are of the last fifth of each run, which shares no sample with the rest.
    """
    length = MAX_UNROLL * runs.substeps
    learning = []
    tested = []
    blocks = 0
    for run, states in enumerate(runs.states):
        cut = len(states) - round(TAIL * len(states))
        firsts = np.arange(max(0, cut - length))
        block = blocks + firsts // (BLOCK * runs.substeps)
        blocks += len(states) // (BLOCK * runs.substeps) + 1
        learning.append(Runs(*runs.windows(run, firsts, MAX_UNROLL), block))
        tail = np.arange(cut, len(states) - runs.substeps)
        tested.append(Runs(*runs.windows(run, tail, 1), np.full(len(tail), run)))
    windows = join_runs(learning)
    tails = join_runs(tested)
    if len(windows.states) < MIN_WINDOWS or not len(tails.states):
        wanted = round((MIN_WINDOWS + length) / (1 - TAIL)) + 1
        raise BadFileError(
            f"{runs.file}: {len(windows.states)} windows to learn from and {len(tails.states)} super steps to test on; "
            f"wanted a run of at least {max(wanted, round(2 * runs.substeps / TAIL)):,} rows. Record longer."
        )
    windows = _evenly(windows, MAX_WINDOWS)
    return _evenly(windows, MAX_WINDOWS).shortened(), _evenly(tails, MAX_TESTED)


def _evenly(runs: Runs, count: int) -> Runs:
    """Return at most `count` of the runs."""
    every = -(-len(runs.states) // count)
    return runs.rows(np.arange(0, len(runs.states), every))
