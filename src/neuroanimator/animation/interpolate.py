"""States between super steps."""

from __future__ import annotations

import numpy as np

from neuroanimator.errors import ArgumentError
from neuroanimator.state.rotation import multiply

Pairs = tuple[tuple[int, int], ...]


def interpolate_linear(
    states: np.ndarray, dt: float, times: np.ndarray, rates: Pairs = (), orientations: Pairs = ()
) -> np.ndarray:
    """Return states (F, S) at `times` [s] on straight lines between states (T, S) `dt` apart, as in 1998."""
    states = _nearest_signs(states, orientations)
    index, share = _locate(states, dt, times)
    return _unit(states[index] * (1 - share) + states[index + 1] * share, orientations)


def interpolate_hermite(
    states: np.ndarray, dt: float, times: np.ndarray, rates: Pairs = (), orientations: Pairs = ()
) -> np.ndarray:
    """Return states (F, S) at `times` [s] on cubics that also have the known velocities.

    `rates` holds (i, j) where entry j is the time derivative of entry i; the positions i follow
    the cubic, the velocities j its derivative, all other entries straight lines. `orientations` holds (i, j)
    where a quaternion begins at i and its angular velocity, in the body's frame, at j: its four
    numbers follow cubics too (q̇ = ½ q ω) and are made a unit quaternion again.
    """
    states = _nearest_signs(states, orientations)
    index, share = _locate(states, dt, times)
    found = states[index] * (1 - share) + states[index + 1] * share
    s = share[:, 0]
    for orientation, angular_velocity in orientations:
        spins = np.concatenate(
            [np.zeros((len(states), 1)), states[:, angular_velocity : angular_velocity + 3]], axis=1
        )
        quaternions = states[:, orientation : orientation + 4]
        slopes = multiply(quaternions, spins) / 2 * dt
        found[:, orientation : orientation + 4] = _cubic(
            s[:, None], quaternions[index], quaternions[index + 1], slopes[index], slopes[index + 1]
        )
    if rates:
        positions, velocities = np.array(rates).T
        before, after = states[index], states[index + 1]
        p0, p1 = before[:, positions], after[:, positions]
        v0, v1 = before[:, velocities] * dt, after[:, velocities] * dt
        found[:, positions] = _cubic(share, p0, p1, v0, v1)
        slope = (
            6 * (share**2 - share) * (p0 - p1)
            + (3 * share**2 - 4 * share + 1) * v0
            + (3 * share**2 - 2 * share) * v1
        )
        found[:, velocities] = slope / dt
    return _unit(found, orientations)


def _cubic(
    s: np.ndarray, p0: np.ndarray, p1: np.ndarray, v0: np.ndarray, v1: np.ndarray
) -> np.ndarray:
    """Return Hermite's cubic at shares `s`, its ends p and their slopes v per interval."""
    return (
        (2 * s**3 - 3 * s**2 + 1) * p0
        + (s**3 - 2 * s**2 + s) * v0
        + (3 * s**2 - 2 * s**3) * p1
        + (s**3 - s**2) * v1
    )


def _nearest_signs(states: np.ndarray, orientations: Pairs) -> np.ndarray:
    """Return `states` with each quaternion's sign the one nearest to the quaternion before."""
    states = np.array(states, dtype=float)
    for orientation, _ in orientations:
        states[:, orientation : orientation + 4] = continuous(
            states[:, orientation : orientation + 4]
        )
    return states


def continuous(quaternions: np.ndarray) -> np.ndarray:
    """Return quaternions (T, ..., 4) with signs flipped so that each is nearest to the one before."""
    dots = (quaternions[1:] * quaternions[:-1]).sum(axis=-1, keepdims=True)
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.concatenate([quaternions[:1], quaternions[1:] * signs])


def _unit(states: np.ndarray, orientations: Pairs) -> np.ndarray:
    for orientation, _ in orientations:
        states[:, orientation : orientation + 4] /= np.linalg.norm(
            states[:, orientation : orientation + 4], axis=1, keepdims=True
        )
    return states


def _locate(states: np.ndarray, dt: float, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return, per time, the super step before it and how far (0..1) it lies into the next."""
    end = (len(states) - 1) * dt
    if len(states) < 2 or times.min() < 0 or times.max() > end + 1e-9:
        raise ArgumentError(f"times: wanted between 0 and {end:g} s of at least two states.")
    position = np.clip(times / dt, 0, len(states) - 1)
    index = np.minimum(position.astype(int), len(states) - 2)
    return index, (position - index)[:, None]


INTERPOLATIONS = {"hermite": interpolate_hermite, "linear": interpolate_linear}
