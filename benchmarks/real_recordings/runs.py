"""Recorded runs on a constant grid of time, how velocities come from positions, and their form as CSV.

The state of a row is positions, then velocities, both in the order of the model's joints. Velocities are slopes of a
cubic that is fitted to the positions around a sample (Savitzky-Golay): they look as far ahead as back, half the width
of the fit, for every method alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_filter

from neuroanimator.files.atomic import write_whole

DEGREE = 3
"""Degree of the polynomials velocities are read off."""

FINE_DT = 1e-3
"""Angles are interpolated at this interval before they are smoothed [s]."""

KEPT = 5
"""Every fifth of these samples is kept."""

DT = KEPT * FINE_DT
"""Sampling interval of recordings of pendulums [s]: some hundred samples in a swing of the shortest link."""

ROUNDING = 1e-9
"""Times are equal within this [s]."""


@dataclass(frozen=True)
class Run:
    """A stretch of recorded motion without a gap."""

    name: str
    states: Float[np.ndarray, "T S"]
    """Positions and velocities at each sample."""
    controls: Float[np.ndarray, "T C"]
    """The control of a row acts until the next row."""
    halves: Float[np.ndarray, "2 T S"] | None = None
    """The states from one half of the samples and from the other, if they are known."""


@dataclass(frozen=True)
class Columns:
    """(name, unit) of every column of a recording, as the model's emulator calls them."""

    state: tuple[tuple[str, str], ...]
    control: tuple[tuple[str, str], ...]


def hinge_columns(hinges: int, controls: tuple[tuple[str, str], ...]) -> Columns:
    """Return the columns of a chain of hinges."""
    names = [f"hinge{number}" for number in range(1, hinges + 1)]
    angles = [(name, "rad") for name in names]
    velocities = [(f"{name}.velocity", "rad/s") for name in names]
    return Columns((*angles, *velocities), controls)


def sampled_states(
    time: Float[np.ndarray, " N"], angles: Float[np.ndarray, "N Q"], width: float
) -> Float[np.ndarray, "T S"]:
    """Return angles and velocities every DT, of the cubics fitted to `width` seconds around each such time.

    Near the ends of a run the first and the last whole fit stand for those that are cut off.
    """
    fine = np.arange(time[0], time[-1] + ROUNDING, FINE_DT)
    resampled = [np.interp(fine, time, column) for column in angles.T]
    columns = np.stack(resampled, axis=1)
    samples = 2 * round(width / FINE_DT / 2) + 1
    places = savgol_filter(columns, samples, DEGREE, axis=0)
    velocities = savgol_filter(columns, samples, DEGREE, deriv=1, delta=FINE_DT, axis=0)
    return np.hstack([places, velocities])[::KEPT]


def half_states(
    time: Float[np.ndarray, " N"], angles: Float[np.ndarray, "N Q"], width: float
) -> Float[np.ndarray, "2 T S"]:
    """Return the states from every second sample alone, and from the others alone.

    Their noise is independent, as far as that of neighbouring samples is: half their difference is as large as the
    error of the states from all samples.
    """
    even = sampled_states(time[::2], angles[::2], width)
    others = np.append(
        0, np.arange(1, len(time), 2)
    )  # the first one, too: both begin at the same time
    odd = sampled_states(time[others], angles[others], width)
    rows = min(len(even), len(odd))
    return np.stack([even[:rows], odd[:rows]])


def write_recording(path: Path, runs: list[Run], columns: Columns, dt: float) -> None:
    """Write runs as a recording of this project: a header of names and units, then a line for each sample."""
    state = [f"state.{name} {unit}" for name, unit in columns.state]
    control = [f"control.{name} {unit}" for name, unit in columns.control]
    lines = [",".join(["run", "time s", *state, *control])]
    for run in runs:
        rows = np.hstack([run.states, run.controls])
        for number, row in enumerate(rows):
            cells = [f"{value:.7g}" for value in row]
            lines.append(",".join([run.name, f"{number * dt:.6f}", *cells]))
    write_whole(path, ("\n".join(lines) + "\n").encode())
