"""Bones for a mass-spring body: along the spine of a swimmer, at the corners of a box, or one per mass point."""

from __future__ import annotations

import os

import numpy as np

from neuroanimator.appearance.binding import Binding, Weights, bound_pose
from neuroanimator.appearance.skeleton import Bone, Shape, Skeleton
from neuroanimator.appearance.skin import Skin, Swimmer
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.deformable.body import Body

SAME_STATION = 0.01
"""Mass points belong to one station of the spine if their X differs by less than this share of the body's length."""
POINT_SIZE = 0.12
"""Radius of the ball drawn at a mass point without skin, over the mean length of springs."""
POINT_COLOUR = (0.25, 0.5, 0.75, 1.0)


def body_skeleton(body: Body, skin: Skin | None) -> Skeleton:
    """Return the bones of `body`, and its `skin` around them; without one a ball at every mass point."""
    if skin is None:
        size = POINT_SIZE * float(body.lengths.mean())
        ball = Shape("sphere", (size,), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), POINT_COLOUR)
        points = [Binding(position=((3 * i, 1.0),)) for i in range(len(body.masses))]
        bones = [
            _bone(name, binding, body, (ball,))
            for name, binding in zip(body.names, points, strict=True)
        ]
    elif isinstance(skin, Swimmer):
        bones = _spine(body)
    else:
        bones = _corners(body)
    return Skeleton(tuple(bones), skin)


def _spine(body: Body) -> list[Bone]:
    """Return a bone per station along X, nose first; each points from the station behind it to the one before."""
    stations = _stations(body.positions)
    if len(stations) < 2:
        raise ArgumentError(
            "skin: kind 'swimmer' wants mass points along X; all of them lie at one place."
        )
    uprights = [_upward(body.positions, station) for station in stations]
    tall = [i for i, weights in enumerate(uprights) if weights]
    if not tall:
        raise ArgumentError(
            "skin: kind 'swimmer' wants mass points above each other somewhere along X."
        )
    bones = []
    for i, station in enumerate(stations):
        ahead, behind = stations[max(i - 1, 0)], stations[min(i + 1, len(stations) - 1)]
        binding = Binding(
            position=_mean(station, 1.0),
            forward=(*_mean(ahead, 1.0), *_mean(behind, -1.0)),
            up=uprights[min(tall, key=lambda other: abs(other - i))],
        )
        bones.append(_bone(_common_name(body, station, i), binding, body))
    return bones


def _stations(positions: np.ndarray) -> list[list[int]]:
    """Return mass points grouped by their X, largest first."""
    order = np.argsort(-positions[:, 0], kind="stable")
    near = SAME_STATION * np.ptp(positions[:, 0])
    stations = [[int(order[0])]]
    for point in order[1:]:
        if positions[stations[-1][0], 0] - positions[point, 0] > near:
            stations.append([])
        stations[-1].append(int(point))
    return [sorted(station) for station in stations]


def _upward(positions: np.ndarray, station: list[int]) -> Weights:
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
    """Return what the names of a station's mass points begin with: 'chest' of 'chest_lu' and 'chest_rd'."""
    common = os.path.commonprefix([body.names[point] for point in station]).rstrip("_.-")  # noqa: RUF071 (no paths)
    return common or f"station {number + 1}"


def _corners(body: Body) -> list[Bone]:
    """Return a bone per corner, in the order `skin_mesh` wants; its axes lie along the two edges that meet there."""
    low, high = body.positions.min(axis=0), body.positions.max(axis=0)
    ends = [np.array([a, b, c]) for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    nearest = [
        int(np.linalg.norm(body.positions - (low + end * (high - low)), axis=1).argmin())
        for end in ends
    ]
    if len({*nearest}) < len(ends) or (high - low).min() <= 0:
        raise ArgumentError("skin: kind 'box' wants eight mass points, one at every corner.")
    bones = []
    for number, point in enumerate(nearest):
        edges = (
            ((3 * nearest[number | bit], 1.0), (3 * nearest[number & ~bit], -1.0)) for bit in (4, 1)
        )
        forward, up = edges
        bones.append(
            _bone(
                body.names[point],
                Binding(position=((3 * point, 1.0),), forward=forward, up=up),
                body,
            )
        )
    return bones


def _bone(name: str, binding: Binding, body: Body, shapes: tuple[Shape, ...] = ()) -> Bone:
    position, orientation = bound_pose(binding, body.positions.reshape(1, -1))
    return Bone(
        name, -1, tuple(position[0].tolist()), tuple(orientation[0].tolist()), (), shapes, binding
    )
