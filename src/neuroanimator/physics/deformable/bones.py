"""Bones for a mass-spring body: along the spine of a swimmer, at the corners of a box, or one per mass point."""

from __future__ import annotations

import os
from itertools import product

import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.binding import Binding, Weights, bound_pose
from neuroanimator.appearance.skeleton import Bone, Shape, Skeleton
from neuroanimator.appearance.skin import Skin, Swimmer
from neuroanimator.errors import ArgumentError
from neuroanimator.physics.deformable.body import Body
from neuroanimator.state.rotation import NO_ROTATION

SAME_STATION = 0.01
"""Difference in X below which mass points belong to one station of the spine, over the body's length."""

POINT_SIZE = 0.12
"""Radius of the ball drawn at a mass point without skin, over the mean length of springs."""

POINT_COLOUR = (0.25, 0.5, 0.75, 1.0)
"""Red, green, blue and opacity of such a ball."""

X_BIT = 4
"""Bit of a corner's number for its end along X."""

Z_BIT = 1
"""Bit of a corner's number for its end along Z."""


def body_skeleton(body: Body, skin: Skin | None) -> Skeleton:
    """Return the bones of `body`, and its `skin` around them; without a skin, a ball at every mass point.

    Raises ArgumentError for a skin that does not fit the body.
    """
    if skin is None:
        bones = _points(body)
    elif isinstance(skin, Swimmer):
        bones = _spine(body)
    else:
        bones = _corners(body)
    return Skeleton(tuple(bones), skin)


def _points(body: Body) -> list[Bone]:
    """Return a bone with a ball per mass point."""
    radius = POINT_SIZE * float(body.lengths.mean())
    ball = Shape("sphere", (radius,), (0.0, 0.0, 0.0), NO_ROTATION, POINT_COLOUR)
    bones = []
    for point, name in enumerate(body.names):
        binding = Binding(position=((3 * point, 1.0),))
        bones.append(_bone(name, binding, body, (ball,)))
    return bones


def _spine(body: Body) -> list[Bone]:
    """Return a bone per station along X, nose first; each points from the station behind it to the one before."""
    stations = _stations(body.positions)
    if len(stations) < 2:
        raise ArgumentError(
            "skin: kind 'swimmer' needs mass points along X; all of them are at the same place."
        )
    uprights = [_upward(body.positions, station) for station in stations]
    tall = [number for number, weights in enumerate(uprights) if weights]
    if not tall:
        raise ArgumentError(
            "skin: kind 'swimmer' needs mass points above each other somewhere along X."
        )
    bones = []
    for number, station in enumerate(stations):
        ahead = stations[max(number - 1, 0)]
        behind = stations[min(number + 1, len(stations) - 1)]
        distances = [abs(other - number) for other in tall]
        nearest_tall = tall[int(np.argmin(distances))]
        binding = Binding(
            position=_mean(station, 1.0),
            forward=(*_mean(ahead, 1.0), *_mean(behind, -1.0)),
            up=uprights[nearest_tall],
        )
        bones.append(_bone(_common_name(body, station, number), binding, body))
    return bones


def _stations(positions: Float[np.ndarray, "N 3"]) -> list[list[int]]:
    """Return mass points grouped by their X, largest first."""
    along = positions[:, 0]
    order = np.argsort(-along, kind="stable").tolist()
    near = SAME_STATION * np.ptp(along)
    stations = [[order[0]]]
    for point in order[1:]:
        if along[stations[-1][0]] - along[point] > near:
            stations.append([])
        stations[-1].append(point)
    return [sorted(station) for station in stations]


def _upward(positions: Float[np.ndarray, "N 3"], station: list[int]) -> Weights:
    """Return weights of the difference between upper and lower mass points; none if all are level."""
    heights = positions[station, 2] - positions[station, 2].mean()
    total = float(np.abs(heights).sum())
    if total <= SAME_STATION * float(np.ptp(positions[:, 0])):
        return ()
    return tuple(
        (3 * point, float(height) / total) for point, height in zip(station, heights, strict=True)
    )


def _mean(station: list[int], sign: float) -> Weights:
    return tuple((3 * point, sign / len(station)) for point in station)


def _common_name(body: Body, station: list[int], number: int) -> str:
    """Return the common prefix of the names of a station's mass points: 'chest' of 'chest_lu' and 'chest_rd'."""
    names = [body.names[point] for point in station]
    common = os.path.commonprefix(names).rstrip("_.-")  # noqa: RUF071 (no paths)
    return common or f"station {number + 1}"


def _corners(body: Body) -> list[Bone]:
    """Return a bone per corner, in the order `skin_mesh` wants; its axes lie along the two edges that meet there."""
    low = body.positions.min(axis=0)
    high = body.positions.max(axis=0)
    nearest = []
    for ends in product((0, 1), repeat=3):
        corner = low + np.array(ends) * (high - low)
        distances = np.linalg.norm(body.positions - corner, axis=1)
        nearest.append(int(distances.argmin()))
    if len(set(nearest)) < len(nearest) or (high - low).min() <= 0:
        raise ArgumentError("skin: kind 'box' needs eight mass points, one at every corner.")
    bones = []
    for number, point in enumerate(nearest):
        binding = Binding(
            position=((3 * point, 1.0),),
            forward=_edge(nearest, number, X_BIT),
            up=_edge(nearest, number, Z_BIT),
        )
        bones.append(_bone(body.names[point], binding, body))
    return bones


def _edge(corners: list[int], number: int, bit: int) -> Weights:
    """Return the edge along the axis of `bit` that meets at a corner, from its low end to its high one."""
    high = corners[number | bit]
    low = corners[number & ~bit]
    return ((3 * high, 1.0), (3 * low, -1.0))


def _bone(name: str, binding: Binding, body: Body, shapes: tuple[Shape, ...] = ()) -> Bone:
    positions, orientations = bound_pose(binding, body.positions.reshape(1, -1))
    return Bone(
        name=name,
        parent=-1,
        offset=tuple(positions[0].tolist()),
        orientation=tuple(orientations[0].tolist()),
        joints=(),
        shapes=shapes,
        binding=binding,
    )
