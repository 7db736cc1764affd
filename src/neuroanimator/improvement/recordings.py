"""Recordings of the true thing, as super steps of an emulator: what controls it was given, and what came of them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.state.layout import Layout
from neuroanimator.storage.files import read_bounded
from neuroanimator.systems.recorded.recording import READERS, Recording, cut_runs
from neuroanimator.systems.trusted_files import MAX_FILE

SAME_TIME = 1e-3
"""Share of a super step by which so many samples may miss it: clocks are better than that."""


class RecordedMotion(NamedTuple):
    """A recorded run, a super step after the other."""

    states: Float[np.ndarray, "K S"]
    """K = T + 1"""
    controls: Float[np.ndarray, "T C"]
    """The mean over each super step."""


class RecordedRuns(NamedTuple):
    """A recording, sample by sample, in an emulator's order of numbers."""

    file: str
    states: tuple[Float[np.ndarray, "_ S"], ...]
    controls: tuple[Float[np.ndarray, "_ C"], ...]
    substeps: int
    """Samples in a super step of the emulator."""


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
    states = tuple(_continuous(run[:, state_order], emulator) for run in recording.states)
    controls = tuple(run[:, control_order] for run in recording.controls)
    return RecordedRuns(recording.file, states, controls, _substeps(recording, emulator.dt))


def column_names(layout: Layout) -> list[str]:
    """Return what the columns of a recording are called, without `state.` or `control.`."""
    names = []
    for part in layout.slices:
        unit = "1" if part.unit == "quaternion" else part.unit
        if part.size == 1:
            names.append(f"{part.name} {unit}")
        else:
            names += [f"{part.name}.{number} {unit}" for number in range(part.size)]
    return names


def motions_of(runs: RecordedRuns, emulator: Emulator) -> list[RecordedMotion]:
    """Return the runs a super step after the other; those that are shorter than one are left out."""
    motions = []
    for states, controls in zip(runs.states, runs.controls, strict=True):
        steps = (len(states) - 1) // runs.substeps
        if steps < 1:
            continue
        stop = steps * runs.substeps
        held = controls[:stop].reshape(steps, runs.substeps, controls.shape[1]).mean(axis=1)
        held = emulator.bounds.clip(held)
        motions.append(RecordedMotion(states[: stop + 1 : runs.substeps], held))
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


def _continuous(states: Float[np.ndarray, "T S"], emulator: Emulator) -> Float[np.ndarray, "T S"]:
    """Return the states with angles that go on over ±π instead of jumping."""
    if emulator.state_structure.cloud is not None:
        return states
    angles = np.flatnonzero(np.asarray(emulator.features.angles).any(axis=0))
    turning = [entry for entry in angles if emulator.state.names[entry].endswith(" rad")]
    continuous = states.copy()
    continuous[:, turning] = np.unwrap(states[:, turning], axis=0)
    return continuous


def _substeps(recording: Recording, dt: float) -> int:
    """Return how many samples make a super step of `dt` [s]."""
    count = round(dt / recording.step)
    if count < 1 or abs(count * recording.step - dt) > SAME_TIME * dt:
        raise BadFileError(
            f"{recording.file}: sampled every {recording.step:g} s, which does not fill the emulator's super step of "
            f"{dt:g} s a whole number of times. Resample it."
        )
    return count
