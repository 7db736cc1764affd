"""Train an emulator on with a recording of the real system, mixed with old windows so that it forgets nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.learn.data.config import MAX_UNROLL
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.held_out import make_test, recorded_runs, system_of
from neuroanimator.learn.evaluation.weakness.config import ImprovementConfig
from neuroanimator.learn.evaluation.weakness.improve import (
    ErrorChange,
    error_changes,
    errors_by_test,
    fresh_data,
    usual_test,
)
from neuroanimator.learn.evaluation.weakness.learning import mix_windows, train_on
from neuroanimator.learn.evaluation.weakness.sampling import RunBatch, join_runs
from neuroanimator.learn.training.train import Report
from neuroanimator.physics.recorded.recording import Recording, open_recording
from neuroanimator.physics.recorded.rotations import without_jumps
from neuroanimator.state.columns import NamesAndUnits, Vocabulary, column_names
from neuroanimator.terminal import phase

TAIL = 0.2
"""Share of each run, at its end, that is kept for the test."""

RECORDED_SHARE = 0.5
"""Share of recorded windows in training: larger than that of simulated ones, as they contradict the old windows."""

MIN_WINDOWS = 100
"""Minimum number of windows to learn from: fewer have no lasting effect."""

MAX_WINDOWS = 100_000
"""Maximum number of windows in training, evenly taken."""

MAX_TESTED = 8_000
"""Maximum number of super steps in the test, evenly taken."""

BLOCK = 8
"""Number of super steps within which windows go to training, or to validation, together: they overlap."""


MAX_TIME_ERROR = 1e-3
"""Largest mismatch between a whole number of samples and a super step, as a share of it: clocks are better."""


class RecordedRuns(NamedTuple):
    """A recording, sample by sample, with its columns in the emulator's order."""

    file: str
    states: tuple[Float[np.ndarray, "_ S"], ...]
    controls: tuple[Float[np.ndarray, "_ C"], ...]
    substeps: int
    """Number of samples in a super step of the emulator."""

    def windows(
        self, run: int, firsts: Int[np.ndarray, " N"], steps: int
    ) -> tuple[Float[np.ndarray, "N F S"], Float[np.ndarray, "N T C"]]:
        """Return states (N, T+1, S), and mean controls (N, T, C), of `steps` super steps from the samples `firsts` of a run."""
        samples = firsts[:, None] + np.arange(steps * self.substeps)
        own = self.controls[run]
        controls = own[samples].reshape(len(firsts), steps, self.substeps, own.shape[1])
        states = self.states[run][firsts[:, None] + self.substeps * np.arange(steps + 1)]
        return states, controls.mean(axis=2)


@dataclass(frozen=True)
class FineTuning:
    """The result of learning from a recording: the new emulator, and errors before and after."""

    emulator: Emulator
    errors: tuple[ErrorChange, ...]
    """Errors on the recording's tail, which was not learnt from, and on usual motions."""
    windows: int
    """Number of windows of the recording that were learnt from."""


def fine_tune(
    emulator: Emulator,
    recording: str | Path,
    out: str | Path,
    *,
    config: ImprovementConfig | None = None,
    data: Transitions | None = None,
    resample: bool = False,
    on_report: Callable[[Report], None] = lambda report: None,
) -> FineTuning:
    """Train `emulator` on with a recording (CSV or NPZ), write it to `out` and return it with its errors before and after.

    The last fifth of each run is its test and never learnt from. Half of the windows learnt from are old: those of
    `data`, or simulated anew where the system allows it. Nothing else is simulated; only the updates, the windows and
    the seed of `config` count. A run found in `run_folder(out)` is continued.

    Raises BadFileError naming the line of a recording that is wrong, and for one that is too short; ArgumentError
    for an emulator of recordings without its `data`.
    """
    config = config or ImprovementConfig()
    system = system_of(emulator)
    learning, tail = split(read_runs(recording, emulator, resample=resample))
    tests = {str(recording): make_test(system, emulator.dt, tail.states, tail.controls)}
    if system.can_simulate:
        data = data or fresh_data(emulator, config)
        with phase("simulating tests"):
            tests["usual"] = usual_test(emulator, system, config.seed)
    else:
        tests["usual"] = recorded_runs(emulator, data)
    assert data is not None
    before = errors_by_test(emulator, tests)
    windows = mix_windows(data, learning, config, RECORDED_SHARE)
    trained = train_on(emulator, learning, windows, Path(out), config, on_report)
    errors = error_changes(before, errors_by_test(trained, tests))
    return FineTuning(trained, errors, len(learning.states))


def read_runs(path: str | Path, emulator: Emulator, *, resample: bool = False) -> RecordedRuns:
    """Return the recording in a CSV or NPZ file, whose columns are the parts of the emulator's state and control.

    Parameters have no columns: the body is that of the emulator's rest. A part of several numbers has a column for
    each: `state.velocity.0 rad/s`, `state.velocity.1 rad/s`. Without any column of a control the body was free.
    Raises BadFileError naming the line and column at fault, missing columns, or a sampling interval that does not
    divide a super step.
    """
    vocabulary = vocabulary_of(emulator)
    recording = open_recording(Path(path), vocabulary, is_resampled=resample)
    state_order = _order(recording.file, vocabulary, "state", recording.state)
    body = emulator.rest[len(state_order) :]
    states = tuple(
        unwrapped(np.hstack([run[:, state_order], np.tile(body, (len(run), 1))]), emulator)
        for run in recording.states
    )
    return RecordedRuns(
        recording.file,
        states,
        held_controls(recording, emulator),
        _substeps(recording.file, recording.step, emulator.dt),
    )


def held_controls(recording: Recording, emulator: Emulator) -> tuple[Float[np.ndarray, "_ C"], ...]:
    """Return the controls of each run in the emulator's order: idle ones if the recording has none, as in a free swing."""
    if not recording.control:
        return tuple(np.tile(emulator.bounds.idle, (len(run), 1)) for run in recording.states)
    order = _order(recording.file, vocabulary_of(emulator), "control", recording.control)
    return tuple(held[:, order] for held in recording.controls)


def vocabulary_of(emulator: Emulator) -> dict[str, list[str]]:
    """Return the names of what a recording may have columns of, by vector: the moving state, and the control."""
    moving = emulator.state.size - len(emulator.parameter_entries)
    return {
        "state": column_names(emulator.state)[:moving],
        "control": column_names(emulator.control),
    }


def split(runs: RecordedRuns) -> tuple[RunBatch, RunBatch]:
    """Return (windows to learn from, super steps to test on).

    The test is the last fifth of each run, which shares no sample with the rest.
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
        learning.append(RunBatch(*runs.windows(run, firsts, MAX_UNROLL), block))
        tail = np.arange(cut, len(states) - runs.substeps)
        tested.append(RunBatch(*runs.windows(run, tail, 1), np.full(len(tail), run)))
    windows = join_runs(learning)
    tails = join_runs(tested)
    if len(windows.states) < MIN_WINDOWS or not len(tails.states):
        wanted = round((MIN_WINDOWS + length) / (1 - TAIL)) + 1
        raise BadFileError(
            f"{runs.file}: {len(windows.states)} windows to learn from and {len(tails.states)} super steps to test on; "
            f"wanted a run of at least {max(wanted, round(2 * runs.substeps / TAIL)):,} rows. Record longer."
        )
    return _evenly(windows, MAX_WINDOWS).shortened(), _evenly(tails, MAX_TESTED)


def _evenly(runs: RunBatch, count: int) -> RunBatch:
    """Return at most `count` of the runs."""
    every = -(-len(runs.states) // count)
    return runs.rows(np.arange(0, len(runs.states), every))


def _order(file: str, vocabulary: Vocabulary, vector: str, columns: NamesAndUnits) -> list[int]:
    """Return the column of each number of a state or a control; BadFileError if one has none."""
    present = [" ".join(column) for column in columns]
    wanted = vocabulary[vector]
    missing = [name for name in wanted if name not in present]
    if missing:
        every = ",".join(f"{vector}.{name}" for name in wanted)
        raise BadFileError(f"{file}: no column '{vector}.{missing[0]}'. Wanted {every}.")
    return [present.index(name) for name in wanted]


def unwrapped(states: Float[np.ndarray, "T S"], emulator: Emulator) -> Float[np.ndarray, "T S"]:
    """Return the states with angles unwrapped beyond ±π."""
    if emulator.state_structure.cloud is not None:
        return states
    names = emulator.state.names
    turning = [entry for entry, name in enumerate(names) if name.endswith(" rad")]
    return without_jumps(states, turning)


def _substeps(file: str, step: float, dt: float) -> int:
    """Return the number of samples, `step` [s] apart, in a super step of `dt` [s]."""
    count = round(dt / step)
    if count < 1 or abs(count * step - dt) > MAX_TIME_ERROR * dt:
        raise BadFileError(
            f"{file}: sampled every {step:g} s; the emulator's super step of {dt:g} s "
            "is not a whole multiple of that. Resample it."
        )
    return count
