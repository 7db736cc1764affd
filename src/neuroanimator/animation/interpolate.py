"""States between super steps."""

from __future__ import annotations

import numpy as np

from neuroanimator.errors import ArgumentError


def interpolate_linear(states: np.ndarray, dt: float, times: np.ndarray, rates: tuple = ()) -> np.ndarray:
    """Return states (F, S) at `times` [s] on straight lines between states (T, S) `dt` apart, as in 1998."""
    index, share = _locate(states, dt, times)
    return states[index] * (1 - share) + states[index + 1] * share


def interpolate_hermite(states: np.ndarray, dt: float, times: np.ndarray, rates: tuple = ()) -> np.ndarray:
    """Return states (F, S) at `times` [s] on cubics that also have the known velocities.

    `rates` holds (i, j) where entry j is the time derivative of entry i; the positions i follow
    the cubic, the velocities j its derivative, all other entries straight lines.
    """
    index, share = _locate(states, dt, times)
    found = states[index] * (1 - share) + states[index + 1] * share
    s = share[:, 0]
    for position, rate in rates:
        p0, p1 = states[index, position], states[index + 1, position]
        v0, v1 = states[index, rate] * dt, states[index + 1, rate] * dt
        found[:, position] = (
            (2 * s**3 - 3 * s**2 + 1) * p0
            + (s**3 - 2 * s**2 + s) * v0
            + (3 * s**2 - 2 * s**3) * p1
            + (s**3 - s**2) * v1
        )
        slope = 6 * (s**2 - s) * (p0 - p1) + (3 * s**2 - 4 * s + 1) * v0 + (3 * s**2 - 2 * s) * v1
        found[:, rate] = slope / dt
    return found


def _locate(states: np.ndarray, dt: float, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return, per time, the super step before it and how far (0..1) it lies into the next."""
    end = (len(states) - 1) * dt
    if len(states) < 2 or times.min() < 0 or times.max() > end + 1e-9:
        raise ArgumentError(f"times: wanted between 0 and {end:g} s of at least two states.")
    position = np.clip(times / dt, 0, len(states) - 1)
    index = np.minimum(position.astype(int), len(states) - 2)
    return index, (position - index)[:, None]


INTERPOLATIONS = {"hermite": interpolate_hermite, "linear": interpolate_linear}
