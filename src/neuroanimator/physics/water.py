"""Water around a body: it resists faces that move into it, and carries mass points or nodes (Tu, PhD thesis, 1996)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from neuroanimator.state.arrays import AnyArray

MIN_AREA = 1e-12
"""Area of a face [m²] added in divisions, so that no direction is 0/0."""


@dataclass(frozen=True)
class Water:
    """A medium that resists faces moving into it, and gives lift."""

    face_drag: float | Float[AnyArray, " ..."]
    """Drag μ of faces [kg/(m²·s)]: a face of area A moving outward at v is pushed back by μ·A·v; one moving inward is not."""
    drag: float | Float[AnyArray, " ..."] = 0.0
    """Damping of every mass point's motion, over its mass [1/s]."""
    buoyancy: float = 1.0
    """Weight of the water the body displaces, over its own."""
    surface: float | None = None
    """Height of the surface [m]; with None water is everywhere, and there is no weight unless the body is righted."""
    depth: float = 0.1
    """Height over which a mass point passes from air to water [m]: about its size."""
    righting: float = 0.0
    """Height of the centre of buoyancy over the centre of mass at rest [m], which keeps the belly down."""

    @property
    def has_gravity(self) -> bool:
        """Whether gravity is felt: not if water is everywhere and nothing distinguishes up from down."""
        return self.surface is not None or self.righting > 0


def wetness(water: Water | None, heights: Float[AnyArray, "N ..."]) -> Float[AnyArray, "N ..."]:
    """Return the share of each mass point that is under water, as if everywhere without a surface."""
    xp = heights.__array_namespace__()
    if water is None or water.surface is None:
        return xp.ones_like(heights)
    return share_under(heights, water.surface, water.depth)


def share_under(
    heights: Float[AnyArray, "N ..."],
    surface: float | Float[AnyArray, " ..."],
    depth: float | Float[AnyArray, " ..."],
) -> Float[AnyArray, "N ..."]:
    """Return the share of points at these heights that is under a `surface` [m], through which they pass over `depth` [m]."""
    xp = heights.__array_namespace__()
    return xp.clip((surface - heights) / depth + 0.5, 0, 1)


def face_forces(
    drag: float | Float[AnyArray, " ..."],
    right: Float[AnyArray, "F 3 ..."],
    up: Float[AnyArray, "F 3 ..."],
    velocities: Float[AnyArray, "F 3 ..."],
    wet: Float[AnyArray, "F ..."],
) -> Float[AnyArray, "F 3 ..."]:
    """Return the water's push on faces that move outward [N]: -μ A max(0, n·v) n, where μ is `Water.face_drag`.

    `right` and `up` are the diagonals of quadrilaterals, or two sides of triangles [m], `velocities` and `wet` the means of
    their corners.
    """
    xp = right.__array_namespace__()
    normals = cross(right, up)  # of twice the area's length
    length = xp.sqrt(dot(normals, normals) + MIN_AREA**2)
    outward_speed = xp.maximum(dot(normals, velocities), 0) / length
    push = (-drag / 2) * outward_speed * wet
    return push[:, None] * normals


def lift_of(
    positions: Float[np.ndarray, "N 3"], masses: Float[np.ndarray, " N"], water: Water | None
) -> Float[np.ndarray, " N"]:
    """Return the lift of every mass point over its weight, which grows upward if the body is righted.

    It is linear in the position, so that it sums to that of the whole body and its centre lies `righting` above the
    centre of mass: Σ m r (1 + a·r) = Σ m r rᵀ a.
    """
    if water is None:
        return np.zeros(len(masses))
    if not water.righting:
        return np.full(len(masses), water.buoyancy)
    total = masses.sum()
    centred = positions - masses @ positions / total
    spread = centred.T @ (masses[:, None] * centred) / total
    offset = np.array([0.0, 0.0, water.righting])
    slope = np.linalg.lstsq(spread, offset, rcond=None)[0]
    return water.buoyancy * (1 + centred @ slope)


def dot(left: Float[AnyArray, "K 3 ..."], right: Float[AnyArray, "K 3 ..."]) -> AnyArray:
    """Return the products of vectors."""
    return left[:, 0] * right[:, 0] + left[:, 1] * right[:, 1] + left[:, 2] * right[:, 2]


def cross(
    left: Float[AnyArray, "K 3 ..."], right: Float[AnyArray, "K 3 ..."]
) -> Float[AnyArray, "K 3 ..."]:
    """Return the vector products of vectors."""
    a, b, c = (left[:, axis] for axis in range(3))
    x, y, z = (right[:, axis] for axis in range(3))
    xp = left.__array_namespace__()
    return xp.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)
