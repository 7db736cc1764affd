"""Velocities that a recording does not hold, estimated from its positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from neuroanimator.physics.recorded.rates import Runs, rate_entries
from neuroanimator.physics.recorded.recording import Recording, read_recording
from neuroanimator.physics.recorded.rotations import entries_in, without_jumps
from neuroanimator.state.units import rate_unit

WINDOW = 5
"""Number of samples through which a parabola is laid (Savitzky and Golay, 1964): noise counts a third as much as in a
difference of neighbours."""

MEASURED = ("rad", "m")
"""Units of positions."""


def unwrapped(recording: Recording) -> Runs:
    """Return each run's states, with angles unwrapped."""
    angles = entries_in(recording.state, "rad")
    return [without_jumps(states, angles) for states in recording.states]


def positions_alone(recording: Recording) -> list[int]:
    """Return the state entries that are angles or places, and whose rate of change is no other entry."""
    units = [unit for _, unit in recording.state]
    rates = rate_entries(unwrapped(recording), recording.step, units)
    return [entry for entry, unit in enumerate(units) if unit in MEASURED and entry not in rates]


def with_velocities(recording: Recording) -> Recording:
    """Return the recording with a velocity for each position that has none, at the end of the state."""
    entries = positions_alone(recording)
    added = []
    for entry in entries:
        name, unit = recording.state[entry]
        added.append((f"{name}.velocity", rate_unit(unit)))
    states = []
    for known, run in zip(recording.states, unwrapped(recording), strict=True):
        states.append(np.hstack([known, _slopes(run[:, entries], recording.step)]))
    return replace(recording, state=(*recording.state, *added), states=tuple(states))


def prepared(digest: str, name: str, is_resampled: bool, has_estimates: bool) -> Recording:
    """Return the recording in the file with this sha256, prepared as its definition says."""
    recording = read_recording(digest, name, is_resampled)
    if has_estimates:
        return with_velocities(recording)
    return recording


def _slopes(positions: Float[np.ndarray, "N D"], step: float) -> Float[np.ndarray, "N D"]:
    # Imported here, as in `resample`: it takes a quarter of a second, and most systems are not recorded.
    from scipy.signal import savgol_filter

    if len(positions) < WINDOW:
        return np.zeros_like(positions)  # too short to learn from
    return np.asarray(savgol_filter(positions, WINDOW, 2, deriv=1, delta=step, axis=0))
