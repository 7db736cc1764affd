"""States between super steps: straight lines as in 1998, or Hermite's cubics through the known velocities."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Pairs
from neuroanimator.state.rotation import continuous, multiply

TIME_ROUNDING = 1e-9
"""Maximum time by which a requested time may lie beyond the last state [s]."""


def interpolate_linear(
    states: Float[np.ndarray, "T S"],
    dt: float,
    times: Float[np.ndarray, " F"],
    rates: Pairs = (),
    orientations: Pairs = (),
) -> Float[np.ndarray, "F S"]:
    """Return the states at `times` [s] on straight lines between `states`, which lie `dt` [s] apart, as in 1998.

    `rates` and `orientations` are those of `interpolate_hermite`; quaternions are normalised again.
    """
    states = _with_nearest_signs(states, orientations)
    index, share = _locate(states, dt, times)
    return _unit(states[index] * (1 - share) + states[index + 1] * share, orientations)


def interpolate_hermite(
    states: Float[np.ndarray, "T S"],
    dt: float,
    times: Float[np.ndarray, " F"],
    rates: Pairs = (),
    orientations: Pairs = (),
) -> Float[np.ndarray, "F S"]:
    """Return the states at `times` [s] on cubics that also have the known velocities; `states` lie `dt` [s] apart.

    `rates` holds (i, j) where entry j is the time derivative of entry i; the positions i follow
    the cubic, the velocities j its derivative, all other entries straight lines. `orientations` holds (i, j)
    where a quaternion begins at i and its angular velocity, in the body's frame, at j: its four
    numbers follow cubics too (q̇ = ½ q ω) and are normalised again.
    """
    states = _with_nearest_signs(states, orientations)
    index, share = _locate(states, dt, times)
    interpolated = states[index] * (1 - share) + states[index + 1] * share
    for orientation, angular_velocity in orientations:
        quaternions = states[:, orientation : orientation + 4]
        real = np.zeros((len(states), 1))
        imaginary = states[:, angular_velocity : angular_velocity + 3]
        slopes = multiply(quaternions, np.concatenate([real, imaginary], axis=1)) / 2 * dt
        interpolated[:, orientation : orientation + 4] = hermite_cubic(
            share, quaternions[index], quaternions[index + 1], slopes[index], slopes[index + 1]
        )
    if rates:
        positions, velocities = np.array(rates).T
        before = states[index]
        after = states[index + 1]
        p0 = before[:, positions]
        p1 = after[:, positions]
        v0 = before[:, velocities] * dt
        v1 = after[:, velocities] * dt
        interpolated[:, positions] = hermite_cubic(share, p0, p1, v0, v1)
        # The derivative of the cubic, per interval.
        slopes = 6 * (share**2 - share) * (p0 - p1)
        slopes = slopes + (3 * share**2 - 4 * share + 1) * v0 + (3 * share**2 - 2 * share) * v1
        interpolated[:, velocities] = slopes / dt
    return _unit(interpolated, orientations)


def hermite_cubic(
    s: Float[np.ndarray, "F 1"],
    p0: Float[np.ndarray, "F K"],
    p1: Float[np.ndarray, "F K"],
    v0: Float[np.ndarray, "F K"],
    v1: Float[np.ndarray, "F K"],
) -> Float[np.ndarray, "F K"]:
    """Return Hermite's cubic at shares `s` of an interval, `p` at its ends with slopes `v` per interval."""
    return (
        (2 * s**3 - 3 * s**2 + 1) * p0
        + (s**3 - 2 * s**2 + s) * v0
        + (3 * s**2 - 2 * s**3) * p1
        + (s**3 - s**2) * v1
    )


def _with_nearest_signs(
    states: Float[np.ndarray, "T S"], orientations: Pairs
) -> Float[np.ndarray, "T S"]:
    """Return a copy of `states`, the sign of each quaternion flipped where that brings it nearer to the one before."""
    states = np.array(states, dtype=float)
    for orientation, _ in orientations:
        entries = slice(orientation, orientation + 4)
        states[:, entries] = continuous(states[:, entries])
    return states


def _unit(states: Float[np.ndarray, "F S"], orientations: Pairs) -> Float[np.ndarray, "F S"]:
    """Return `states`, their quaternions normalised in place."""
    for orientation, _ in orientations:
        entries = slice(orientation, orientation + 4)
        states[:, entries] /= np.linalg.norm(states[:, entries], axis=1, keepdims=True)
    return states


def _locate(
    states: Float[np.ndarray, "T S"], dt: float, times: Float[np.ndarray, " F"]
) -> tuple[Int[np.ndarray, " F"], Float[np.ndarray, "F 1"]]:
    """Return, for each time, the index of the super step it lies in and how far into it (0..1).

    Raises ArgumentError for times beyond the states, and for fewer than two states.
    """
    end = (len(states) - 1) * dt
    if len(states) < 2 or times.min() < 0 or times.max() > end + TIME_ROUNDING:
        raise ArgumentError(f"times: wanted between 0 and {end:g} s of at least two states.")
    position = np.clip(times / dt, 0, len(states) - 1)
    index = np.minimum(position.astype(int), len(states) - 2)
    return index, (position - index)[:, None]


INTERPOLATIONS = {"hermite": interpolate_hermite, "linear": interpolate_linear}
"""The interpolations by name."""
