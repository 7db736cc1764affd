"""Keep-out zones on level ground, and a body's distance from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.objective import ALL_ALONG, TimedTerm
from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import as_numbers
from neuroanimator.state.pose import read_pose
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import System


@dataclass(frozen=True)
class Zone:
    """An axis-aligned upright box, grown by a radius: a post is a box of size zero."""

    position: tuple[float, float]
    """Middle of the box [m]."""
    half: tuple[float, float] = (0.0, 0.0)
    """Half its extent along x and y [m]."""
    radius: float = 0.0
    """Radius by which it is grown [m]."""


def distances(zones: AnyArray, points: AnyArray) -> AnyArray:
    """Return the distances (..., P, K) of points (..., P, 2) from zones (K, 5) [m]; negative inside."""
    xp = points.__array_namespace__()
    beyond = xp.abs(points[..., None, :] - zones[:, :2]) - zones[:, 2:4]
    outside = xp.maximum(beyond, xp.zeros_like(beyond))
    deep = xp.minimum(xp.max(beyond, axis=-1), xp.zeros_like(beyond[..., 0]))
    # The square root has no finite gradient at 0: a small offset keeps it finite.
    return xp.sqrt(xp.sum(outside**2, axis=-1) + 1e-12) + deep - zones[:, 4]


def footprint(structure: Structure, states: AnyArray, probes: AnyArray) -> AnyArray:
    """Return the positions in the plane (..., P, 2) of points (P, 2) of a body, ahead and to the left of its origin [m]."""
    xp, pose = states.__array_namespace__(), read_pose(structure, states)
    ahead = pose.forward[..., :2] / xp.linalg.vector_norm(
        pose.forward[..., :2], axis=-1, keepdims=True
    )
    left = xp.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    shift = probes[:, :1] * ahead[..., None, :] + probes[:, 1:] * left[..., None, :]
    return pose.position[..., None, :2] + shift


class Avoid(TimedTerm):
    """Term for keeping discs around a body's probes out of zones: ∫ of their depth inside, over the margin."""

    structure: Structure = eqx.field(static=True)
    zones: Float[AnyArray, "K 5"]
    probes: Float[AnyArray, "P 2"]
    margin: Float[AnyArray, ""]
    """Radius of the discs: half the body's width and some room [m]."""

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B O"]:
        points = footprint(self.structure, state, self.probes)
        xp = state.__array_namespace__()
        within = xp.maximum(self.margin - distances(self.zones, points), 0)
        return within.reshape(*state.shape[:-1], -1)

    def compare(self, observed: Float[AnyArray, "T O"], dt: float) -> Float[AnyArray, " R"]:
        return self.when.share(dt) * (observed / self.margin).ravel()


def avoid(
    system: System,
    zones: list[Zone],
    *,
    probes: ArrayLike = ((0.0, 0.0),),
    margin: float,
    weight: float = 1.0,
) -> Avoid:
    """Return the cost of coming nearer than `margin` [m] to `zones` with any of the `probes` (P, 2) [m] of the body."""
    points = as_numbers(probes, "probes")
    is_sound = points.ndim == 2 and points.shape[1] == 2 and np.isfinite(points).all()
    if not zones or not is_sound or not 0 < margin < math.inf:
        raise ArgumentError(
            f"avoid: wanted zones, finite probes (P, 2) and margin above 0, got {len(zones)}, {points.shape}, {margin:g}."
        )
    read_pose(system.structure, system.rest)
    return Avoid(
        weight=as_parameter(weight),
        when=ALL_ALONG,
        structure=system.structure,
        zones=as_parameter(zone_rows(zones)),
        probes=as_parameter(points),
        margin=as_parameter(margin),
    )


def zone_rows(zones: list[Zone]) -> np.ndarray:
    """Return the zones as numbers (K, 5)."""
    return np.array([[*zone.position, *zone.half, zone.radius] for zone in zones])
