"""Recordings of a real system, in an emulator's order of numbers and cut into its super steps."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.evaluation.weakness.sampling import Motion
from neuroanimator.state.layout import Layout
from neuroanimator.storage.files import read_bounded
from neuroanimator.systems.recorded.recording import READERS, Recording, cut_runs
from neuroanimator.systems.trusted_files import MAX_FILE

MAX_TIME_ERROR = 1e-3
"""Share of a super step by which a whole number of samples may miss it: clocks are better than that."""


class RecordedRuns(NamedTuple):
    """A recording, sample by sample, in an emulator's order of numbers."""

    file: str
    states: tuple[Float[np.ndarray, "_ S"], ...]
    controls: tuple[Float[np.ndarray, "_ C"], ...]
    substeps: int
    """Samples in a super step of the emulator."""

    def windows(
        self, run: int, firsts: Int[np.ndarray, " N"], steps: int
    ) -> tuple[Float[np.ndarray, "N F S"], Float[np.ndarray, "N T C"]]:
        """Return states (N, T+1, S), and mean controls (N, T, C), of `steps` super steps from the samples `firsts` of a run."""
        samples = firsts[:, None] + np.arange(steps * self.substeps)
        own = self.controls[run]
        controls = own[samples].reshape(len(firsts), steps, self.substeps, own.shape[1])
        states = self.states[run][firsts[:, None] + self.substeps * np.arange(steps + 1)]
        return states, controls.mean(axis=2)


def read_runs(path: str | Path, emulator: Emulator) -> RecordedRuns:
    """Return the recording in a CSV or NPZ file, whose columns are the parts of the emulator's state and control.

    A part of several numbers has a column for each: `state.velocity.0 rad/s`, `state.velocity.1 rad/s`. Raises
    BadFileError naming the line and the column that is wrong, columns that are missing, and an interval that does
    not fill a super step.
    """
    path = Path(path)
    read = READERS.get(path.suffix)
    if read is None:
        raise BadFileError(f"{path}: recordings end in {', '.join(READERS)}.")
    recording = cut_runs(read(read_bounded(path, MAX_FILE), path.name), path.name)
    state_order = _order(recording, "state", emulator.state, recording.state)
    control_order = _order(recording, "control", emulator.control, recording.control)
    states = tuple(_unwrapped(run[:, state_order], emulator) for run in recording.states)
    controls = tuple(run[:, control_order] for run in recording.controls)
    return RecordedRuns(recording.file, states, controls, _substeps(recording, emulator.dt))


def column_names(layout: Layout) -> list[str]:
    """Return the names of a recording's columns, without `state.` or `control.`."""
    names = []
    for part in layout.slices:
        unit = "1" if part.unit == "quaternion" else part.unit
        indices = [f".{number}" for number in range(part.size)] if part.size > 1 else [""]
        names += [f"{part.name}{index} {unit}" for index in indices]
    return names


def motions_of(runs: RecordedRuns, emulator: Emulator) -> list[Motion]:
    """Return the runs as motions of whole super steps; those that are shorter than one are left out."""
    motions = []
    for run, states in enumerate(runs.states):
        steps = (len(states) - 1) // runs.substeps
        if steps:
            windows, held = runs.windows(run, np.zeros(1, int), steps)
            motions.append((windows[0], emulator.bounds.clip(held[0])))
    if not motions:
        raise BadFileError(
            f"{runs.file}: no run is as long as a super step of {emulator.dt:g} s. Record longer."
        )
    return motions


def _order(
    recording: Recording, vector: str, layout: Layout, columns: tuple[tuple[str, str], ...]
) -> list[int]:
    """Return which column holds each number of a state or a control."""
    present = [f"{name} {unit}" for name, unit in columns]
    wanted = column_names(layout)
    missing = [name for name in wanted if name not in present]
    extra = [name for name in present if name not in wanted]
    if missing or extra:
        faults = [f"no column '{vector}.{name}'" for name in missing[:1]]
        faults += [f"'{vector}.{name}' is none of the emulator's" for name in extra[:1]]
        listed = ",".join(f"{vector}.{name}" for name in wanted)
        raise BadFileError(f"{recording.file}: {' and '.join(faults)}. Wanted {listed}.")
    return [present.index(name) for name in wanted]


def _unwrapped(states: Float[np.ndarray, "T S"], emulator: Emulator) -> Float[np.ndarray, "T S"]:
    """Return the states with angles that go on over ±π instead of jumping."""
    if emulator.state_structure.cloud is not None:
        return states
    is_angle = np.asarray(emulator.features.angles).any(axis=0)
    names = emulator.state.names
    turning = [entry for entry in np.flatnonzero(is_angle) if names[entry].endswith(" rad")]
    unwrapped = states.copy()
    unwrapped[:, turning] = np.unwrap(states[:, turning], axis=0)
    return unwrapped


def _substeps(recording: Recording, dt: float) -> int:
    """Return how many samples make a super step of `dt` [s]."""
    count = round(dt / recording.step)
    if count < 1 or abs(count * recording.step - dt) > MAX_TIME_ERROR * dt:
        raise BadFileError(
            f"{recording.file}: sampled every {recording.step:g} s, which does not fill the emulator's super step of "
            f"{dt:g} s a whole number of times. Resample it."
        )
    return count
