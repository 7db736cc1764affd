"""Train an emulator on with a recording of the real system, mixed with old windows so that it forgets nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.data.config import MAX_UNROLL
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
from neuroanimator.evaluation.weakness.sampling import Runs, join_runs
from neuroanimator.state.layout import Layout
from neuroanimator.systems.recorded.recording import Recording, open_recording
from neuroanimator.terminal import phase
from neuroanimator.training.train import Report

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
    learning, tail = split(read_runs(recording, emulator))
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


def read_runs(path: str | Path, emulator: Emulator) -> RecordedRuns:
    """Return the recording in a CSV or NPZ file, whose columns are the parts of the emulator's state and control.

    Parameters have no columns: the body is that of the emulator's rest. A part of several numbers has a column for
    each: `state.velocity.0 rad/s`, `state.velocity.1 rad/s`. Without any column of a control the body was free.
    Raises BadFileError naming the line and column at fault, missing columns, or a sampling interval that does not
    divide a super step.
    """
    recording = open_recording(Path(path))
    moving = emulator.state.size - len(emulator.parameter_entries)
    names = column_names(emulator.state)[:moving]
    state_order = _order(recording, "state", names, recording.state)
    controls = tuple(_controls(recording, run, emulator) for run in range(len(recording.states)))
    body = emulator.rest[moving:]
    states = tuple(
        unwrapped(np.hstack([run[:, state_order], np.tile(body, (len(run), 1))]), emulator)
        for run in recording.states
    )
    return RecordedRuns(recording.file, states, controls, _substeps(recording, emulator.dt))


def _controls(recording: Recording, run: int, emulator: Emulator) -> Float[np.ndarray, "_ C"]:
    """Return the controls of a run; those of rest where the recording has none, as in a free swing."""
    if not recording.control:
        return np.tile(emulator.bounds.idle, (len(recording.states[run]), 1))
    order = _order(recording, "control", column_names(emulator.control), recording.control)
    return recording.controls[run][:, order]


def column_names(layout: Layout) -> list[str]:
    """Return the names of a recording's columns, without `state.` or `control.`."""
    names = []
    for part in layout.slices:
        unit = "1" if part.unit == "quaternion" else part.unit
        indices = [f".{number}" for number in range(part.size)] if part.size > 1 else [""]
        names += [f"{part.name}{index} {unit}" for index in indices]
    return names


def split(runs: RecordedRuns) -> tuple[Runs, Runs]:
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
    return _evenly(windows, MAX_WINDOWS).shortened(), _evenly(tails, MAX_TESTED)


def _evenly(runs: Runs, count: int) -> Runs:
    """Return at most `count` of the runs."""
    every = -(-len(runs.states) // count)
    return runs.rows(np.arange(0, len(runs.states), every))


def _order(
    recording: Recording, vector: str, wanted: list[str], columns: tuple[tuple[str, str], ...]
) -> list[int]:
    """Return the column of each of the `wanted` numbers of a state or a control."""
    present = [f"{name} {unit}" for name, unit in columns]
    missing = [name for name in wanted if name not in present]
    extra = [name for name in present if name not in wanted]
    if missing or extra:
        faults = [f"no column '{vector}.{name}'" for name in missing[:1]]
        faults += [f"'{vector}.{name}' is no column of the emulator" for name in extra[:1]]
        listed = ",".join(f"{vector}.{name}" for name in wanted)
        raise BadFileError(f"{recording.file}: {' and '.join(faults)}. Wanted {listed}.")
    return [present.index(name) for name in wanted]


def unwrapped(states: Float[np.ndarray, "T S"], emulator: Emulator) -> Float[np.ndarray, "T S"]:
    """Return the states with angles unwrapped beyond ±π."""
    if emulator.state_structure.cloud is not None:
        return states
    is_angle = np.asarray(emulator.features.angles).any(axis=0)
    names = emulator.state.names
    turning = [entry for entry in np.flatnonzero(is_angle) if names[entry].endswith(" rad")]
    unwrapped = states.copy()
    unwrapped[:, turning] = np.unwrap(states[:, turning], axis=0)
    return unwrapped


def _substeps(recording: Recording, dt: float) -> int:
    """Return the number of samples in a super step of `dt` [s]."""
    count = round(dt / recording.step)
    if count < 1 or abs(count * recording.step - dt) > MAX_TIME_ERROR * dt:
        raise BadFileError(
            f"{recording.file}: sampled every {recording.step:g} s; the emulator's super step of {dt:g} s "
            "is not a whole multiple of that. Resample it."
        )
    return count
