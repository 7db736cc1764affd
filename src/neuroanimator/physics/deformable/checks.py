"""Checks of a deformable body's nodes, springs, muscles and steps, which name faults before anything is simulated.

Faces are checked in `build.py`, left and right in `mirror.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.errors import ArgumentError
from neuroanimator.physics.deformable.body import Body, area_vectors, length_jacobian
from neuroanimator.physics.pieces import pieces_of
from neuroanimator.physics.schemes import schemes_of
from neuroanimator.text import listed

if TYPE_CHECKING:
    from neuroanimator.definitions.body import BodyDefinition


MIN_SPRING_LENGTH = 1e-9
"""Minimum distance between the ends of a spring [m]: a shorter spring has no direction."""

RK4_OVER_SYMPLECTIC = 1.3
"""Lower bound of the ratio of rk4's largest stable step to symplectic Euler's, at any damping (1.39 to 1.41)."""

MAX_SHORTENING = 0.9
"""Maximum share of its length by which all muscles together may shorten a spring: more leaves almost nothing of it."""


def check_nodes(definition: BodyDefinition, max_nodes: int) -> None:
    """Refuse too many mass points, and those without mass."""
    if len(definition.nodes) > max_nodes:
        raise ArgumentError(
            f"nodes: wanted at most {max_nodes}, got {len(definition.nodes)}. Use a coarser body."
        )
    for name, (*_, mass) in definition.nodes.items():
        if mass <= 0:
            raise ArgumentError(
                f"nodes.{name}: wanted [x, y, z, mass] with a mass above 0 kg, got {mass:g} kg. "
                "Give it its share of the body's mass."
            )


def check_springs(
    names: Sequence[str],
    positions: Float[np.ndarray, "N 3"],
    springs: Int[np.ndarray, "P 2"],
    max_springs: int,
) -> None:
    """Refuse too many springs, springs without length, doubled ones, and a body in several pieces.

    `names` are those of the mass points, `positions` [m] those at rest.
    """
    if len(springs) > max_springs:
        raise ArgumentError(
            f"springs: wanted at most {max_springs}, got {len(springs)}. Use a coarser body."
        )
    lengths = np.linalg.norm(positions[springs[:, 1]] - positions[springs[:, 0]], axis=1)
    earlier: set[frozenset[int]] = set()
    for ends, length in zip(springs.tolist(), lengths, strict=True):
        pair = [names[i] for i in ends]
        if length < MIN_SPRING_LENGTH:
            raise ArgumentError(
                f"springs: {pair} has no length at rest: both ends are at the same place. Move one, or leave it out."
            )
        if frozenset(ends) in earlier:
            raise ArgumentError(
                f"springs: {pair} is there twice. Leave one out, or add up their stiffness."
            )
        earlier.add(frozenset(ends))
    _check_connected(names, springs)


def _check_connected(names: Sequence[str], springs: Int[np.ndarray, "P 2"]) -> None:
    pieces = pieces_of(len(names), springs)
    sizes = np.bincount(pieces)
    if len(sizes) > 1:
        smallest = [names[i] for i in np.flatnonzero(pieces == sizes.argmin()).tolist()]
        raise ArgumentError(
            f"springs: the body is in {len(sizes)} pieces; no spring connects {listed(smallest)} "
            "to the rest. Add springs, or make it a body of its own."
        )


def check_muscles(
    names: Sequence[str], springs: Int[np.ndarray, "P 2"], muscles: Float[np.ndarray, "P M"]
) -> None:
    """Refuse muscles that together leave a spring almost none of its length."""
    total = muscles.sum(axis=1)
    if (total > MAX_SHORTENING).any():
        worst = int(np.argmax(total))
        pair = [names[i] for i in springs[worst]]
        raise ArgumentError(
            f"muscles.shorten: the muscles together shorten {pair} by {total[worst]:g} "
            f"of its length; wanted at most {MAX_SHORTENING:g}. Shorten less, or give each its own spring."
        )


def check_steps(definition: BodyDefinition, body: Body) -> None:
    """Refuse a step at which the body's own small vibrations would grow."""
    limit = largest_stable_step(body)
    keys = ("step", "truth_step", "fine_step")
    for key, scheme in zip(keys, schemes_of(definition.physics), strict=True):
        integrator = scheme.integrator
        largest = limit * RK4_OVER_SYMPLECTIC if integrator == "rk4" else limit
        if scheme.dt > largest:
            why = "they grow"
            if integrator == "semi-implicit":
                why = "its matrix holds nothing of a spring at rest"
            raise ArgumentError(
                f"physics.{key}: {scheme.dt:g} s is too large for the fastest vibrations: {integrator} needs at most "
                f"{largest:.3g} s ({why}). Take a smaller step, softer springs or more mass."
            )


def largest_stable_step(body: Body) -> float:
    """Return the largest step δt [s] at which symplectic Euler is stable for small vibrations about rest.

    For ẍ + D ẋ + K x = 0 it is where 4 - 2 δt D - δt² K stops being positive definite. Its roots
    μ = 1/δt, of μ² - μ D/2 - K/4, are the eigenvalues of a symmetric matrix twice as large. Springs,
    water and ground are assumed to act all at once. Tu's semi-implicit scheme has the same limit: at
    rest its springs' effective stiffness is zero. Raises ArgumentError for a body without stiff springs.
    """
    jacobian = length_jacobian(body) / _mass_roots(body)
    spring_stiffness = jacobian.T @ (body.stiffness[:, None] * jacobian)
    spring_damping = jacobian.T @ (body.damping[:, None] * jacobian)
    if not spring_stiffness.any():
        raise ArgumentError("springs: the body has no springs that hold it together.")
    stiffness = spring_stiffness + _ground_stiffness(body)
    damping = spring_damping + _water_damping(body)
    squared_frequencies, modes = np.linalg.eigh(stiffness)
    half_root = (modes * np.sqrt(np.maximum(squared_frequencies, 0))) @ modes.T / 2
    matrix = np.block([[damping / 2, half_root], [half_root, np.zeros_like(half_root)]])
    return float(1 / np.linalg.eigvalsh(matrix)[-1])


def _ground_stiffness(body: Body) -> Float[np.ndarray, "X X"]:
    """Return the ground's stiffness over the masses [1/s²], as if all mass points touched it."""
    upward = np.zeros_like(body.positions)
    if body.ground is not None:
        upward[:, 2] = body.ground.stiffness
    return np.diag(upward.ravel() / _mass_roots(body) ** 2)


def _water_damping(body: Body) -> Float[np.ndarray, "X X"]:
    """Return the water's damping over the masses [1/s], as if all faces moved outward at rest."""
    size = body.positions.size
    if body.water is None:
        return np.zeros((size, size))
    drag = body.water.drag * np.eye(size)
    if not len(body.faces):
        return drag
    areas = area_vectors(body.positions, body.faces)
    weights = np.sqrt(body.water.face_drag / np.linalg.norm(areas, axis=1))
    flows = weights[:, None, None] * body.face_shares[:, :, None] * areas[:, None]
    scaled = flows.reshape(len(areas), size) / _mass_roots(body)
    return drag + scaled.T @ scaled


def _mass_roots(body: Body) -> Float[np.ndarray, " X"]:
    """Return the square root of each coordinate's mass."""
    return np.sqrt(np.repeat(body.masses, 3))
