"""The largest stable step of a mass-spring body: linear stability of its small vibrations about rest.

A body of N mass points has X = 3N coordinates.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import ArgumentError
from neuroanimator.physics.deformable.body import Body, length_jacobian


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
    corners = body.positions[body.faces]
    areas = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
    weights = np.sqrt(body.water.face_drag / np.linalg.norm(areas, axis=1))
    flows = weights[:, None, None] * body.face_shares[:, :, None] * areas[:, None]
    scaled = flows.reshape(len(areas), size) / _mass_roots(body)
    return drag + scaled.T @ scaled


def _mass_roots(body: Body) -> Float[np.ndarray, " X"]:
    """Return the square root of each coordinate's mass."""
    return np.sqrt(np.repeat(body.masses, 3))
