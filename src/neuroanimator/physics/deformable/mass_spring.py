"""The physics of deformable bodies in JAX: mass points, springs, muscles, water and ground, and their integrators.

    m ẍ + ρ ẋ - w = f        (the seminar paper's eq. 2)

w is the force of the springs, f that of water, weight, ground and external forces. Arrays are
(N, 3, ...): axes after mass points and coordinates are a batch, so that the same number of many bodies
lies side by side (eight times faster than body after body). The numbers of a body may have such a batch, too: see
`body_parameters.body_at`. Springs and water after Tu, PhD thesis, 1996.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Bool, Float

from neuroanimator.physics.deformable.body import Body, point_forces
from neuroanimator.physics.water import dot, face_forces, wetness
from neuroanimator.state.arrays import AnyArray

MIN_LENGTH = 1e-12
"""Minimum length of springs in divisions [m], so that no direction is 0/0."""

MIN_VOLUME = 1e-6
"""Minimum determinant of Σ r rᵀ over the springs at a mass point, over its cubed trace, for them to span a volume."""

Seconds = float | Float[Array, ""]
"""A time [s], also one traced by JAX."""


class BodyState(NamedTuple):
    """The positions and velocities of a body's mass points, and the activations of its muscles."""

    positions: Float[Array, "N 3 ..."]
    """Positions of the mass points [m]."""
    velocities: Float[Array, "N 3 ..."]
    """Velocities of the mass points [m/s]."""
    activations: Float[Array, "M ..."]
    """Activations of the muscles, from -1 to 1, where a muscle is shortest."""


def spring_stiffness(
    body: Body,
    positions: Float[Array, "N 3 ..."],
    velocities: Float[Array, "N 3 ..."],
    activations: Float[Array, "M ..."],
) -> tuple[Float[Array, "P ..."], Float[Array, "P 3 ..."]]:
    """Return effective stiffness [N/m] and extent [m] of every spring; their product is its force."""
    first, second = body.springs.T
    extent = positions[second] - positions[first]
    parting = velocities[second] - velocities[first]
    rest_lengths = _rest_lengths(body, activations, extent[:, 0])
    stiffness = _along(body.stiffness, rest_lengths)
    damping = _along(body.damping, rest_lengths)
    return effective_stiffness(extent, parting, stiffness, damping, rest_lengths), extent


def effective_stiffness(
    extent: Float[Array, "P 3 ..."],
    parting: Float[Array, "P 3 ..."],
    stiffness: Float[Array, "P ..."],
    damping: Float[Array, "P ..."],
    rest_lengths: Float[Array, "P ..."],
) -> Float[Array, "P ..."]:
    """Return n = (c·(|r| - l) + k·ė) / |r| of springs [N/m], after Tu: negative in compression.

    `extent` is r [m], `parting` its rate [m/s].
    """
    inverse = 1 / jnp.sqrt(dot(extent, extent) + MIN_LENGTH**2)
    rate = dot(extent, parting) * inverse
    return stiffness + (damping * rate - stiffness * rest_lengths) * inverse


def spring_forces(body: Body, state: BodyState) -> Float[Array, "N 3 ..."]:
    """Return the springs' force on every mass point [N]."""
    stiffness, extent = spring_stiffness(body, *state)
    return _sum_at_ends(body, stiffness[:, None] * extent)


def outer_forces(
    body: Body, state: BodyState, controls: Float[Array, "C ..."]
) -> Float[Array, "N 3 ..."]:
    """Return all other forces on every mass point [N]: water, weight, ground, external forces."""
    positions, velocities, _ = state
    heights = positions[:, 2]
    wet = wetness(body.water, heights)
    masses = _along(body.masses, heights)
    force = point_forces(body, positions, velocities, masses, _along(body.lift, heights), wet)
    if body.water is not None and len(body.faces):
        force = force + _water_forces(body, positions, velocities, wet)
    if body.external_forces.any():
        share = _along(body.masses / body.masses.sum(axis=0), positions)
        total = jnp.tensordot(body.external_forces.astype(positions.dtype), controls, 1)
        force = force + share * total
    return force


def strains(body: Body, positions: Float[AnyArray, "N 3 ..."]) -> Float[AnyArray, "P ..."]:
    """Return every spring's relative change of length, computed by NumPy for NumPy's `positions`."""
    first, second = body.springs.T
    extent = positions[second] - positions[first]
    length = positions.__array_namespace__().sqrt(dot(extent, extent))
    return length / _along(body.lengths, length) - 1


def is_inside_out(body: Body, positions: Float[np.ndarray, "*B N 3"]) -> Bool[np.ndarray, " *B"]:
    """Return whether the body is inside out at any mass point: a face has passed through another one.

    The deformation gradient F at a mass point is fitted to the springs that meet there (Müller et al., SCA 2004): its
    determinant is then negative. The sign does not depend on stretches of the shape at rest along an axis. Mass points
    whose springs span no volume are left out.
    """
    first, second = body.springs.T
    meets = np.zeros((len(body.masses), len(body.springs)))
    meets[first, np.arange(len(first))] = 1
    meets[second, np.arange(len(second))] = 1
    at_rest = _spring_products(meets, body.extents, body.extents)
    size = np.trace(at_rest, axis1=-2, axis2=-1)
    spans_volume = np.linalg.det(at_rest) > MIN_VOLUME * size**3
    extents = positions[..., second, :] - positions[..., first, :]
    products = _spring_products(meets[spans_volume], extents, body.extents)
    return np.asarray((np.linalg.det(products) < 0).any(axis=-1))


def _spring_products(
    meets: Float[np.ndarray, "K P"],
    extents: Float[np.ndarray, "*B P 3"],
    extents_at_rest: Float[np.ndarray, "P 3"],
) -> Float[np.ndarray, "*B K 3 3"]:
    """Return the sum of r r₀ᵀ over the springs that meet at each of K mass points: F times the positive sum at rest."""
    products = extents[..., :, None] * extents_at_rest[:, None, :]
    sums = meets @ products.reshape(*products.shape[:-2], 9)
    return sums.reshape(*sums.shape[:-1], 3, 3)


def _rest_lengths(
    body: Body, activations: Float[Array, "M ..."], lengths: Float[Array, "P ..."]
) -> Float[Array, "P ..."]:
    """Return the length without force of every spring [m], shortened by its muscles, in the precision of `lengths`."""
    shortening = jnp.tensordot(body.muscles.astype(lengths.dtype), activations, 1)
    return _along(body.lengths, lengths) * (1 - shortening)


def _water_forces(
    body: Body,
    positions: Float[Array, "N 3 ..."],
    velocities: Float[Array, "N 3 ..."],
    wet: Float[Array, "N ..."],
) -> Float[Array, "N 3 ..."]:
    """Return the water's push on faces as forces on their corners [N]."""
    assert body.water is not None
    a, b, c, d = (positions[body.faces[:, i]] for i in range(4))
    shares = body.face_shares.astype(positions.dtype)
    mean_velocities = jnp.tensordot(shares, velocities, 1)
    mean_wetness = jnp.tensordot(shares, wet, 1)
    forces = face_forces(body.water.face_drag, c - a, d - b, mean_velocities, mean_wetness)
    return jnp.tensordot(shares.T, forces, 1)


def _along(numbers: Float[AnyArray, "N ..."], like: AnyArray) -> AnyArray:
    """Return `numbers` (N,), or (N, B...) if bodies differ, as an array that multiplies `like` (N, ..., B...)."""
    xp = like.__array_namespace__()
    count, *batch = numbers.shape
    between = (1,) * (like.ndim - numbers.ndim)
    return xp.asarray(numbers, dtype=like.dtype).reshape((count, *between, *batch))


def _sum_at_ends(body: Body, pulls: Float[Array, "P 3 ..."]) -> Float[Array, "N 3 ..."]:
    """Return the sum of the springs' `pulls` at every mass point, reversed at a spring's second end."""
    first, second = body.springs.T
    zeros = jnp.zeros((len(body.masses), *pulls.shape[1:]), pulls.dtype)
    return zeros.at[first].add(pulls).at[second].add(-pulls)


def _activations_after(
    body: Body,
    activations: Float[Array, "M ..."],
    controls: Float[Array, "C ..."],
    seconds: Seconds,
) -> Float[Array, "M ..."]:
    """Return the activations after `seconds` of held controls, which they approach exponentially."""
    if not activations.shape[0]:
        return activations
    if body.time_constant <= 0:
        return controls
    remaining = np.exp(-seconds / body.time_constant)
    return controls + (activations - controls) * remaining


def _acceleration(
    body: Body, state: BodyState, controls: Float[Array, "C ..."]
) -> Float[Array, "N 3 ..."]:
    force = spring_forces(body, state) + outer_forces(body, state, controls)
    return force / _along(body.masses, state.positions)


def symplectic_step(
    body: Body, state: BodyState, controls: Float[Array, "C ..."], dt: Seconds
) -> BodyState:
    """Return the state after one step of symplectic Euler, order 1: explicit and cheapest."""
    velocities = state.velocities + dt * _acceleration(body, state, controls)
    positions = state.positions + dt * velocities
    activations = _activations_after(body, state.activations, controls, dt)
    return BodyState(positions, velocities, activations)


def semi_implicit_step(
    body: Body, state: BodyState, controls: Float[Array, "C ..."], dt: Seconds
) -> BodyState:
    """Return the state after one step of Tu's scheme, order 1: velocities first, from a linear system.

    (M/δt + δt K) v' = M/δt v + f, with the springs' effective stiffness in K. In compression it is negative:
    there it is left out, or the matrix would not be positive definite, nor the energy bounded.
    """
    stiffness, extent = spring_stiffness(body, *state)
    inner = _sum_at_ends(body, stiffness[:, None] * extent)
    force = inner + outer_forces(body, state, controls)
    matrix = implicit_matrix(body, jnp.maximum(stiffness, 0), dt)
    right_side = force + _along(body.masses / dt, state.velocities) * state.velocities
    velocities = _solve(matrix, right_side)
    positions = state.positions + dt * velocities
    activations = _activations_after(body, state.activations, controls, dt)
    return BodyState(positions, velocities, activations)


def implicit_matrix(
    body: Body, stiffness: Float[Array, "P ..."], dt: Seconds
) -> Float[Array, "... N N"]:
    """Return M/δt + δt·K, K from the springs' effective `stiffness` [N/m]."""
    first, second = body.springs.T
    count = len(body.masses)
    scaled = jnp.moveaxis(stiffness, 0, -1) * dt
    matrix = jnp.zeros((*scaled.shape[:-1], count, count), scaled.dtype)
    matrix = matrix.at[..., first, first].add(scaled).at[..., second, second].add(scaled)
    matrix = matrix.at[..., first, second].add(-scaled).at[..., second, first].add(-scaled)
    masses = jnp.moveaxis(jnp.asarray(body.masses, scaled.dtype), 0, -1)
    return matrix + masses[..., None] * jnp.eye(count, dtype=scaled.dtype) / dt


def _solve(
    matrices: Float[Array, "... N N"], right_side: Float[Array, "N 3 ..."]
) -> Float[Array, "N 3 ..."]:
    """Return the solution of each body's linear system, by Cholesky."""
    shape = right_side.shape
    columns = jnp.moveaxis(right_side.reshape(*shape[:2], -1), -1, 0)
    if matrices.ndim == 2:
        solution = _solve_one(matrices, columns)
    else:
        solution = jax.vmap(_solve_one)(matrices, columns)
    return jnp.moveaxis(solution.reshape(-1, *shape[:2]), 0, -1).reshape(shape)


def _solve_one(matrix: Array, columns: Array) -> Array:

    return cho_solve(cho_factor(matrix, lower=True), columns)


def rk4_step(
    body: Body, state: BodyState, controls: Float[Array, "C ..."], dt: Seconds
) -> BodyState:
    """Return the state after one step of the classical Runge-Kutta scheme, of order 4 for smooth forces."""
    positions, velocities, activations = state
    middle = _activations_after(body, activations, controls, 0.5 * dt)
    last = _activations_after(body, activations, controls, 1.0 * dt)

    def slopes(x_slope: Array, v_slope: Array, share: float, held: Array) -> tuple[Array, Array]:
        """Return the derivatives of positions and velocities, a `share` of the step along the given ones."""
        v = velocities + share * dt * v_slope
        x = positions + share * dt * x_slope
        return v, _acceleration(body, BodyState(x, v, held), controls)

    x1, v1 = slopes(velocities, velocities, 0.0, activations)
    x2, v2 = slopes(x1, v1, 0.5, middle)
    x3, v3 = slopes(x2, v2, 0.5, middle)
    x4, v4 = slopes(x3, v3, 1.0, last)
    change = dt / 6 * (x1 + 2 * x2 + 2 * x3 + x4)
    gain = dt / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
    return BodyState(positions + change, velocities + gain, last)


Stepper = Callable[[Body, BodyState, Array, Seconds], BodyState]
STEPPERS: dict[str, Stepper] = {
    "symplectic": symplectic_step,
    "semi-implicit": semi_implicit_step,
    "rk4": rk4_step,
}
"""Step functions of the integrators, by their names in definitions."""


def advance(
    body: Body,
    integrator: str,
    dt: Seconds,
    steps: int,
    state: BodyState,
    controls: Float[Array, "C ..."],
) -> BodyState:
    """Return the state after `steps` physics steps of `dt` [s] under held controls."""
    step = STEPPERS[integrator]
    if body.time_constant <= 0 and state.activations.shape[0]:
        state = state._replace(activations=controls)  # at once: else the first step is of order 1

    def one_step(state: BodyState, _: None) -> tuple[BodyState, None]:
        return step(body, state, controls, dt), None

    return jax.lax.scan(one_step, state, None, length=steps)[0]


def trajectory(
    body: Body,
    integrator: str,
    dt: Seconds,
    steps: int,
    start: BodyState,
    controls: Float[Array, "T C ..."],
) -> BodyState:
    """Return the states (T, ...) after each of the controls, each held for `steps` physics steps."""

    def hold(state: BodyState, held: Array) -> tuple[BodyState, BodyState]:
        following = advance(body, integrator, dt, steps, state, held)
        return following, following

    return jax.lax.scan(hold, start, controls)[1]
