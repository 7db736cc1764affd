"""Recorded motions for identification: on the grid of an emulator's super steps, cut into windows.

A recording holds some of the state's numbers, at its own rate; all others are NaN here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.learn.evaluation.weakness.fine_tune import (
    MAX_TIME_ERROR,
    held_controls,
    unwrapped,
    vocabulary_of,
)
from neuroanimator.physics.recorded.recording import Recording, open_recording
from neuroanimator.physics.recorded.resample import held_means

WINDOW_STEPS = 16
"""Number of super steps in a window: long enough that parameters show, short enough that errors stay small."""

MIN_STEPS = 3
"""Minimum number of super steps in a window: with fewer, its start explains everything."""

SHORTEST = 4
"""Number of super steps in the first windows of a fit, if longer ones are a multiple of it."""

MAX_WINDOWS = 4096
"""Maximum number of windows: each has its own start to be found."""


@dataclass(frozen=True)
class Measurements:
    """Windows of recorded motions, `dt` between their frames; NaN where nothing was measured."""

    measured: Float[np.ndarray, "W F S"]
    """Measured numbers of the state at the start and after each super step."""
    controls: Float[np.ndarray, "W T C"]
    """Mean control of each super step."""
    guess: Float[np.ndarray, "W F S"]
    """Initial guess of the whole states: as measured, with velocities from positions."""
    names: tuple[str, ...]
    """Names and units of the measured numbers of the state."""
    entries: tuple[int, ...]
    """State entries that were measured."""
    files: tuple[str, ...]

    @property
    def steps(self) -> int:
        """Number of super steps in a window."""
        return self.controls.shape[1]

    def split(self, parts: int) -> Measurements:
        """Return the same motions in windows split into `parts` equal parts, in order."""
        frames = self.steps // parts
        firsts = frames * np.arange(parts)
        shown = firsts[:, None] + np.arange(frames + 1)
        held = firsts[:, None] + np.arange(frames)
        return replace(
            self,
            measured=_joined(self.measured[:, shown]),
            controls=_joined(self.controls[:, held]),
            guess=_joined(self.guess[:, shown]),
        )


def _joined(windows: Float[np.ndarray, "W P F N"]) -> Float[np.ndarray, "Q F N"]:
    """Return the parts of all windows concatenated."""
    return windows.reshape(-1, *windows.shape[2:])


@dataclass(frozen=True)
class _Grid:
    """One run on the grid of super steps."""

    measured: Float[np.ndarray, "F S"]
    guess: Float[np.ndarray, "F S"]
    controls: Float[np.ndarray, "T C"]


def read_measurements(
    paths: Sequence[str | Path],
    emulator: Emulator,
    window: float | None = None,
    *,
    resample: bool = False,
) -> Measurements:
    """Return the recordings in CSV or NPZ files as windows of `window` seconds (by default `WINDOW_STEPS` super steps).

    Columns are parts of the state, not necessarily all, and all controls; without any control column the body was free.
    With `resample`, samples at uneven times are interpolated. Raises BadFileError with the file and what is wrong with it,
    ArgumentError for a window that is too short.
    """
    if not paths:
        raise ArgumentError("recordings: wanted at least one, CSV or NPZ.")
    steps = _window_steps(emulator.dt, window)
    grids: list[_Grid] = []
    columns: tuple[int, ...] = ()
    for path in map(Path, paths):
        recording = open_recording(path, vocabulary_of(emulator), is_resampled=resample)
        found, runs = _on_grid(recording, emulator)
        if columns and found != columns:
            raise BadFileError(
                f"{recording.file}: other columns than the recording before it. Give recordings of the same sensors."
            )
        columns = found
        grids += runs
    longest = max(len(grid.controls) for grid in grids)
    steps = min(steps, longest)
    if steps < MIN_STEPS:
        raise BadFileError(
            f"{Path(paths[0]).name}: the longest run lasts {longest} super steps of {emulator.dt:g} s; wanted at least "
            f"{MIN_STEPS}. Record longer, or train an emulator of fewer substeps."
        )
    return _cut(grids, steps, columns, emulator, tuple(Path(path).name for path in paths))


def _window_steps(dt: float, window: float | None) -> int:
    if window is None:
        return WINDOW_STEPS
    steps = round(window / dt)
    if steps > SHORTEST:
        steps = SHORTEST * round(steps / SHORTEST)  # so that it can be split
    if steps < MIN_STEPS:
        raise ArgumentError(
            f"window: wanted at least {MIN_STEPS} super steps, {MIN_STEPS * dt:g} s, got {window:g} s."
        )
    return steps


def _on_grid(recording: Recording, emulator: Emulator) -> tuple[tuple[int, ...], list[_Grid]]:
    """Return (state entries that were measured, the runs on the grid of super steps)."""
    names = vocabulary_of(emulator)["state"]
    entries = tuple(names.index(" ".join(column)) for column in recording.state)
    grids = []
    for states, held in zip(recording.states, held_controls(recording, emulator), strict=True):
        measured = np.full((len(states), emulator.state.size), np.nan)
        measured[:, list(entries)] = states
        measured = unwrapped(measured, emulator)
        grid = _resampled(recording, measured, held, emulator)
        if len(grid.controls) >= MIN_STEPS:
            grids.append(grid)
    if not grids:
        longest = max(len(states) for states in recording.states) * recording.step
        raise BadFileError(
            f"{recording.file}: its longest run lasts {longest:g} s; wanted {MIN_STEPS} super steps of {emulator.dt:g} s. "
            "Record longer."
        )
    return entries, grids


def _resampled(
    recording: Recording,
    measured: Float[np.ndarray, "N S"],
    held: Float[np.ndarray, "N C"],
    emulator: Emulator,
) -> _Grid:
    """Return a run resampled at the times of super steps."""
    dt = emulator.dt
    guess = _guessed(measured, recording.step, emulator)
    if recording.step > dt * (1 + MAX_TIME_ERROR):
        return _sparse(recording, measured, guess, held, dt)
    times = recording.step * np.arange(len(measured))
    steps = int(times[-1] / dt + MAX_TIME_ERROR)
    frames = np.minimum(dt * np.arange(steps + 1), times[-1])
    edges = recording.step * np.arange(len(held) + 1)
    mean = held_means(edges, held, frames)
    return _Grid(_interpolated(times, measured, frames), _interpolated(times, guess, frames), mean)


def _interpolated(
    times: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N S"],
    frames: Float[np.ndarray, " F"],
) -> Float[np.ndarray, "F S"]:
    """Return `values` at other times, by cubic splines; columns that were not measured stay NaN."""
    result = np.full((len(frames), values.shape[1]), np.nan)
    known = np.isfinite(values).all(axis=0)
    result[:, known] = CubicSpline(times, values[:, known])(frames)
    return result


def _sparse(
    recording: Recording,
    measured: Float[np.ndarray, "N S"],
    guess: Float[np.ndarray, "N S"],
    held: Float[np.ndarray, "N C"],
    dt: float,
) -> _Grid:
    """Return a run sampled less often than every super step: NaN at the super steps in between."""
    every = round(recording.step / dt)
    if abs(every * dt - recording.step) > MAX_TIME_ERROR * dt:
        raise BadFileError(
            f"{recording.file}: sampled every {recording.step:g} s, which is not a whole number of super steps of {dt:g} s. "
            "Resample it, or train an emulator whose super step fits."
        )
    steps = (len(measured) - 1) * every
    sparse = np.full((steps + 1, measured.shape[1]), np.nan)
    sparse[::every] = measured
    times = recording.step * np.arange(len(guess))
    filled = _interpolated(times, guess, dt * np.arange(steps + 1))
    return _Grid(sparse, filled, np.repeat(held[:-1], every, axis=0))


def _guessed(
    measured: Float[np.ndarray, "N S"], step: float, emulator: Emulator
) -> Float[np.ndarray, "N S"]:
    """Return guesses of the whole states: velocities that were not measured come from positions."""
    guess = measured.copy()
    for position, velocity in emulator.rates:
        if np.isnan(guess[:, velocity]).any() and len(guess) > 1:
            guess[:, velocity] = np.gradient(guess[:, position], step)
    return np.where(np.isnan(guess), emulator.rest, guess)


def _cut(
    grids: list[_Grid],
    steps: int,
    entries: tuple[int, ...],
    emulator: Emulator,
    files: tuple[str, ...],
) -> Measurements:
    """Return consecutive windows of `steps` super steps of each run; if there are too many, an evenly spaced selection."""
    measured = []
    guess = []
    controls = []
    for grid in grids:
        for first in range(0, len(grid.controls) - steps + 1, steps):
            measured.append(grid.measured[first : first + steps + 1])
            guess.append(grid.guess[first : first + steps + 1])
            controls.append(grid.controls[first : first + steps])
    every = -(-len(guess) // MAX_WINDOWS)
    names = emulator.state.names
    return Measurements(
        measured=np.stack(measured[::every]),
        controls=np.stack(controls[::every]),
        guess=np.stack(guess[::every]),
        names=tuple(names[entry] for entry in entries),
        entries=entries,
        files=files,
    )
