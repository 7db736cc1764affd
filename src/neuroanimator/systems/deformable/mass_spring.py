"""Mass points, springs, muscles, water and ground: the physics of deformable bodies, in JAX.

    m ẍ + ρ ẋ - w = f        (the seminar paper's eq. 2)

w is the force of the springs, f that of water, weight, ground and pushes. Arrays are (N, 3, ...): what
comes after mass points and axes is a batch, so that the same number of many bodies lies side by side
(eight times faster than body after body). Springs and water after Tu, PhD thesis, 1996.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Float

from neuroanimator.state.rotation import Numbers
from neuroanimator.systems.deformable.body import GRAVITY, Body

SMALLEST = 1e-12
"""[m or m²] Springs and faces are never taken as smaller, so that no direction is 0/0."""


class Motion(NamedTuple):
    """Where a body is, how it moves, how far its muscles are contracted."""

    positions: Float[Array, "N 3 ..."]
    """[m]"""
    velocities: Float[Array, "N 3 ..."]
    """[m/s]"""
    activations: Float[Array, "C ..."]
    """1: a muscle as short as it gets."""


def spring_stiffness(
    body: Body, positions: Array, velocities: Array, activations: Array
) -> tuple[Array, Array]:
    """Return effective stiffness (P, ...) [N/m] and extent (P, 3, ...) [m] of every spring; their product is its force.

    n = (c·(|r| - l) + k·ė) / |r| after Tu: negative in compression. Muscles shorten the rest length l.
    """
    first, second = body.springs.T
    extent, parting = positions[second] - positions[first], velocities[second] - velocities[first]
    length = jnp.sqrt(_dot(extent, extent) + SMALLEST**2)
    rest = _along(body.lengths, length) * (
        1 - jnp.tensordot(body.muscles.astype(length.dtype), activations, 1)
    )
    rate = _dot(extent, parting) / length
    stretch = _along(body.stiffness, length) * (length - rest) + _along(body.damping, length) * rate
    return stretch / length, extent


def spring_forces(body: Body, motion: Motion) -> Array:
    """Return the springs' force on every mass point (N, 3, ...) [N]."""
    stiffness, extent = spring_stiffness(body, *motion)
    return _gather(body, stiffness[:, None] * extent)


def outer_forces(body: Body, motion: Motion, controls: Array) -> Array:
    """Return all other forces on every mass point (N, 3, ...) [N]: water, weight, ground, pushes."""
    positions, velocities, _ = motion
    force = jnp.zeros_like(positions)
    wet = _wet(body, positions)
    if body.water is not None:
        force = force + _water_forces(body, positions, velocities, wet)
    if body.has_gravity:
        lift = 0.0 if body.water is None else _along(body.lift, wet) * wet
        force = force.at[:, 2].add(_along(body.masses, positions[:, 2]) * GRAVITY * (lift - 1))
    if body.ground is not None:
        force = force + _ground_forces(body, positions, velocities)
    if body.external_forces.any():
        share = _along(body.masses / body.masses.sum(), positions)
        force = force + share * jnp.tensordot(
            body.external_forces.astype(positions.dtype), controls, 1
        )
    return force


def energy(body: Body, motion: Motion) -> Array:
    """Return (...) kinetic and elastic energy, and that of weight [J]: in air, or in water without a surface."""
    heights = motion.positions[:, 2]
    is_immersed = body.water is not None and body.water.surface is None
    weights = GRAVITY * body.masses * (1 - body.lift * is_immersed)
    return internal_energy(body, motion) + jnp.sum(_along(weights, heights) * heights, axis=0)


def internal_energy(body: Body, motion: Motion) -> Array:
    """Return (...) kinetic and elastic energy [J]: what does not depend on the place."""
    positions, velocities, activations = motion
    kinetic = jnp.sum(_along(body.masses, velocities) * velocities * velocities, axis=(0, 1)) / 2
    first, second = body.springs.T
    length = jnp.sqrt(
        _dot(positions[second] - positions[first], positions[second] - positions[first])
    )
    rest = _along(body.lengths, length) * (
        1 - jnp.tensordot(body.muscles.astype(length.dtype), activations, 1)
    )
    elastic = jnp.sum(_along(body.stiffness, length) * (length - rest) ** 2, axis=0) / 2
    return kinetic + elastic


def strains(body: Body, positions: Numbers) -> Numbers:
    """Return every spring's (P, ...) relative change of length; of NumPy's `positions` (N, 3, ...) by NumPy."""
    first, second = body.springs.T
    extent = positions[second] - positions[first]
    length = positions.__array_namespace__().sqrt(_dot(extent, extent))
    return length / _along(body.lengths, length) - 1


def _water_forces(body: Body, positions: Array, velocities: Array, wet: Array) -> Array:
    """Return the water's drag on mass points, and its push on faces that move outward: -μ A max(0, n·v) n."""
    water = body.water
    assert water is not None
    drag = -water.drag * _along(body.masses, velocities) * velocities * wet[:, None]
    if not len(body.faces):
        return drag
    corners = [positions[body.faces[:, i]] for i in range(4)]
    area = _cross(corners[2] - corners[0], corners[3] - corners[1]) / 2
    shares = body.face_shares.astype(positions.dtype)
    speed, wetness = jnp.tensordot(shares, velocities, 1), jnp.tensordot(shares, wet, 1)
    outward = jnp.maximum(_dot(area, speed), 0) / jnp.sqrt(_dot(area, area) + SMALLEST**2)
    push = -water.face_drag * (outward * wetness)[:, None] * area
    return drag + jnp.tensordot(shares.T, push, 1)


def _wet(body: Body, positions: Array) -> Array:
    """Return how far each mass point (N, ...) is under water, 0 to 1."""
    if body.water is None or body.water.surface is None:
        return jnp.ones_like(positions[:, 2])
    return jnp.clip((body.water.surface - positions[:, 2]) / body.water.depth + 0.5, 0, 1)


def _ground_forces(body: Body, positions: Array, velocities: Array) -> Array:
    ground = body.ground
    assert ground is not None
    depth = jnp.maximum(-positions[:, 2], 0)
    upward = ground.stiffness * depth * jnp.maximum(1 - ground.damping * velocities[:, 2], 0)
    sliding = velocities[:, :2] / jnp.sqrt(
        jnp.sum(velocities[:, :2] ** 2, axis=1, keepdims=True) + ground.slip**2
    )
    return jnp.concatenate([-ground.friction * upward[:, None] * sliding, upward[:, None]], axis=1)


def _along(numbers: np.ndarray, like: Numbers) -> Numbers:
    """Return `numbers` (N,) as an array that multiplies `like` (N, ...)."""
    xp = like.__array_namespace__()
    return xp.asarray(numbers, dtype=like.dtype).reshape((-1,) + (1,) * (like.ndim - 1))


def _dot(left: Numbers, right: Numbers) -> Numbers:
    return left[:, 0] * right[:, 0] + left[:, 1] * right[:, 1] + left[:, 2] * right[:, 2]


def _cross(left: Array, right: Array) -> Array:
    (a, b, c), (x, y, z) = ((each[:, 0], each[:, 1], each[:, 2]) for each in (left, right))
    return jnp.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)


def _gather(body: Body, pulls: Array) -> Array:
    """Return the sum of the springs' `pulls` (P, 3, ...) at every mass point."""
    first, second = body.springs.T
    zeros = jnp.zeros((len(body.masses), *pulls.shape[1:]), pulls.dtype)
    return zeros.at[first].add(pulls).at[second].add(-pulls)


def _activated(body: Body, activations: Array, controls: Array, seconds: float) -> Array:
    """Return the contractions after `seconds` of held controls, to which they tend exponentially."""
    if not activations.shape[0]:
        return activations
    if body.time_constant <= 0:
        return controls
    return controls + (activations - controls) * np.exp(-seconds / body.time_constant)


def _acceleration(body: Body, motion: Motion, controls: Array) -> Array:
    return (spring_forces(body, motion) + outer_forces(body, motion, controls)) / _along(
        body.masses, motion.positions
    )


def symplectic_step(body: Body, motion: Motion, controls: Array, dt: float) -> Motion:
    """Return the motion after one step of symplectic Euler, order 1: explicit and cheapest."""
    positions, _, activations = motion
    velocities = motion.velocities + dt * _acceleration(body, motion, controls)
    return Motion(
        positions + dt * velocities, velocities, _activated(body, activations, controls, dt)
    )


def semi_implicit_step(body: Body, motion: Motion, controls: Array, dt: float) -> Motion:
    """Return the motion after one step of Tu's scheme, order 1: velocities first, from a linear system.

    (M/δt + δt K) v' = M/δt v + f, with the springs' effective stiffness in K. In compression it is negative
    and would take the matrix its positive definiteness, and the motion its energy bound: there it is left out.
    """
    positions, velocities, activations = motion
    stiffness, extent = spring_stiffness(body, *motion)
    force = _gather(body, stiffness[:, None] * extent) + outer_forces(body, motion, controls)
    matrix = implicit_matrix(body, jnp.maximum(stiffness, 0), dt)
    pushed = force + _along(body.masses / dt, velocities) * velocities
    columns = jnp.moveaxis(pushed.reshape(*pushed.shape[:2], -1), -1, 0)
    found = (
        cho_solve(cho_factor(matrix, lower=True), columns)
        if matrix.ndim == 2
        else _solve(matrix, columns)
    )
    velocities = jnp.moveaxis(found.reshape(-1, *pushed.shape[:2]), 0, -1).reshape(velocities.shape)
    return Motion(
        positions + dt * velocities, velocities, _activated(body, activations, controls, dt)
    )


def implicit_matrix(body: Body, stiffness: Array, dt: float) -> Array:
    """Return M/δt + δt·K (..., N, N), K from the springs' effective `stiffness` (P, ...)."""
    first, second = body.springs.T
    count, along = len(body.masses), jnp.moveaxis(stiffness, 0, -1) * dt
    matrix = jnp.zeros((*along.shape[:-1], count, count), along.dtype)
    matrix = matrix.at[..., first, first].add(along).at[..., second, second].add(along)
    matrix = matrix.at[..., first, second].add(-along).at[..., second, first].add(-along)
    return matrix + jnp.diag(jnp.asarray(body.masses, along.dtype)) / dt


def _solve(matrices: Array, columns: Array) -> Array:
    return jax.vmap(lambda matrix, column: cho_solve(cho_factor(matrix, lower=True), column))(
        matrices, columns
    )


def rk4_step(body: Body, motion: Motion, controls: Array, dt: float) -> Motion:
    """Return the motion after one step of the classical Runge-Kutta scheme, order 4 where forces are smooth."""
    positions, velocities, activations = motion
    middle, last = (_activated(body, activations, controls, share * dt) for share in (0.5, 1.0))

    def slope(v_ahead: Array, x_ahead: Array, share: float, held: Array) -> tuple[Array, Array]:
        v = velocities + share * dt * v_ahead
        return v, _acceleration(body, Motion(positions + share * dt * x_ahead, v, held), controls)

    x1, v1 = slope(velocities, velocities, 0.0, activations)
    x2, v2 = slope(v1, x1, 0.5, middle)
    x3, v3 = slope(v2, x2, 0.5, middle)
    x4, v4 = slope(v3, x3, 1.0, last)

    def mean(a, b, c, d):
        return dt / 6 * (a + 2 * b + 2 * c + d)

    return Motion(positions + mean(x1, x2, x3, x4), velocities + mean(v1, v2, v3, v4), last)


Stepper = Callable[[Body, Motion, Array, float], Motion]
STEPPERS: dict[str, Stepper] = {
    "symplectic": symplectic_step,
    "semi-implicit": semi_implicit_step,
    "rk4": rk4_step,
}


def advance(
    body: Body, integrator: str, dt: float, steps: int, motion: Motion, controls: Array
) -> Motion:
    """Return the motion after `steps` physics steps of `dt` [s] under held controls (C, ...)."""
    step = STEPPERS[integrator]
    if body.time_constant <= 0 and motion.activations.shape[0]:
        motion = motion._replace(activations=controls)  # at once: else the first step is of order 1

    def one(motion, _):
        return (step(body, motion, controls, dt), None)

    return jax.lax.scan(one, motion, None, length=steps)[0]


def trajectory(
    body: Body, integrator: str, dt: float, steps: int, motion: Motion, controls: Array
) -> Motion:
    """Return the motions (T, ...) after each of the controls (T, C, ...), each held for `steps` physics steps."""

    def follow(motion: Motion, held: Array) -> tuple[Motion, Motion]:
        following = advance(body, integrator, dt, steps, motion, held)
        return following, following

    return jax.lax.scan(follow, motion, controls)[1]
