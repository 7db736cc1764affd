"""The motion of nodes in the body's own frame: that of the mover that holds it, or of the closest rigid motion.

A free body's frame has its origin at the centre of mass, and is turned so that the nodes b in it are closest to the
mean a: Σ m a × b = 0 (Horn, 1987). Its angular velocity is the frame's own, so that rates are the derivatives of
amplitudes; for a rigid motion it agrees with the angular momentum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.state.reference_shape import closest_quaternion
from neuroanimator.state.rotation import rotation_matrices, to_body_axes

ManyPoints = Float[np.ndarray, "*B N 3"]
"""Positions of the nodes of many bodies [m], or their velocities [m/s]."""

Matrices = Float[np.ndarray, "*B 3 3"]
"""A matrix for each of many bodies."""


class OwnMotion(NamedTuple):
    """The motion of N nodes in their body's own frame."""

    root: Float[np.ndarray, "*B R"]
    """Position, quaternion, velocity and angular velocity (in its own axes) of a free body's frame; else empty."""
    positions: ManyPoints
    """Positions [m]."""
    velocities: ManyPoints
    """Time derivatives of the positions [m/s]."""


def seen_from_mover(
    positions: ManyPoints,
    velocities: ManyPoints,
    position: Float[np.ndarray, "*B 3"],
    orientation: Float[np.ndarray, "*B 4"] | None,
    rates: Float[np.ndarray, "*B R"],
) -> OwnMotion:
    """Return the motion in the frame of a mover: `rates` are its velocity, and its turning rate or angular velocity."""
    dtype = positions.dtype
    away = positions - position[..., None, :].astype(dtype)
    relative = velocities - rates[..., None, :3].astype(dtype)
    root = np.zeros((*positions.shape[:-2], 0))
    if orientation is None:
        return OwnMotion(root, away, relative)
    away = to_body_axes(orientation.astype(dtype), away)
    relative = to_body_axes(orientation.astype(dtype), relative)
    spin = spin_of(rates).astype(dtype)
    return OwnMotion(root, away, relative - np.cross(spin[..., None, :], away))


def spin_of(rates: Float[np.ndarray, "*B R"]) -> Float[np.ndarray, "*B 3"]:
    """Return the angular velocity of a mover along its own axes [rad/s]: what follows its velocity, or its turn about Z."""
    turning = rates[..., 3:]
    if turning.shape[-1] == 3:
        return turning
    return np.stack([np.zeros(turning.shape[:-1])] * 2 + [turning.sum(axis=-1)], axis=-1)


def seen_from_root(
    positions: ManyPoints,
    velocities: ManyPoints,
    mean: Float[np.ndarray, "N 3"],
    masses: Float[np.ndarray, " N"],
) -> OwnMotion:
    """Return the motion of a free body in the frame of the closest rigid motion."""
    shares = masses / masses.sum()
    centre = np.einsum("n,...nk->...k", shares, positions)
    velocity = np.einsum("n,...nk->...k", shares, velocities)
    away = positions - centre[..., None, :].astype(positions.dtype)
    relative = velocities - velocity[..., None, :].astype(positions.dtype)
    moments = np.swapaxes(away, -1, -2).astype(float) @ (shares[:, None] * mean)
    orientation = closest_quaternion(_finite(moments).mT)
    turned = rotation_matrices(orientation)
    own_axes = turned.astype(positions.dtype)
    away = away @ own_axes
    relative = relative @ own_axes
    # Σ m a × (v - ω × b) = 0, where a × (ω × b) = (a · b) ω - b (a · ω).
    spread = np.swapaxes(turned, -1, -2) @ moments
    spread = np.trace(spread, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - spread
    swept = np.einsum("ni,...nj->...ij", shares[:, None] * mean, relative)
    spins = [swept[..., i, j] - swept[..., j, i] for i, j in ((1, 2), (2, 0), (0, 1))]
    spin = np.stack(spins, axis=-1)
    angular_velocity = np.linalg.solve(_finite(spread), spin[..., None])[..., 0]
    relative -= np.cross(angular_velocity[..., None, :].astype(positions.dtype), away)
    root = np.concatenate([centre, orientation, velocity, angular_velocity], axis=-1)
    return OwnMotion(root, away, relative)


def _finite(matrices: Matrices) -> Matrices:
    """Return `matrices`, with the identity for those of diverged motions."""
    is_finite = np.isfinite(matrices).all(axis=(-2, -1), keepdims=True)
    return np.where(is_finite, matrices, np.eye(3))
