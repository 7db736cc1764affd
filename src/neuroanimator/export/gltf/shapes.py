"""Simple shapes as triangles, in the frame of the bone they belong to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuroanimator.appearance.skeleton import Shape
from neuroanimator.export.gltf.buffers import float32
from neuroanimator.state.rotation import rotate

AROUND, ALONG = 20, 12
"""Points around the axis and from pole to pole: smooth at arm's length, 240 points a capsule."""


class Mesh(NamedTuple):
    """Triangles with their corners' normals."""

    points: np.ndarray
    """(N, 3) float32 [m]"""
    normals: np.ndarray
    """(N, 3) float32, unit length, outward"""
    triangles: np.ndarray
    """(M, 3) uint16, counter-clockwise from outside"""


def shape_mesh(shape: Shape) -> Mesh:
    """Return the triangles of `shape`."""
    points, normals, triangles = MAKERS[shape.kind](np.array(shape.size))
    orientation = np.broadcast_to(np.array(shape.orientation), (len(points), 4))
    placed = rotate(orientation, points) + np.array(shape.position)
    return Mesh(float32(placed), float32(rotate(orientation, normals)), triangles.astype(np.uint16))


Parts = tuple[np.ndarray, np.ndarray, np.ndarray]


def _capsule(size: np.ndarray) -> Parts:
    return _rounded(np.full(3, size[0]), size[1])


def _sphere(size: np.ndarray) -> Parts:
    return _rounded(np.full(3, size[0]), 0.0)


def _ellipsoid(size: np.ndarray) -> Parts:
    return _rounded(size, 0.0)


def _rounded(axes: np.ndarray, half_length: float) -> Parts:
    """Return an ellipsoid of half axes `axes`, its halves moved apart along Z by `half_length` each way."""
    latitudes = np.linspace(-np.pi / 2, np.pi / 2, ALONG)[:, None]
    unit = np.concatenate(
        [np.cos(latitudes)[..., None] * _ring(), np.sin(latitudes)[..., None] * _up()], axis=-1
    )
    shift = np.where(latitudes < 0, -half_length, half_length)
    points = unit * axes + shift[..., None] * [0, 0, 1]
    normals = unit / axes
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return points.reshape(-1, 3), normals.reshape(-1, 3), _bands(ALONG)


def _cylinder(size: np.ndarray) -> Parts:
    """Return the mantle and two caps; corners are doubled where the surface has an edge."""
    radius, half = size[0], size[1]
    ring = np.concatenate([_ring()[0], np.zeros((AROUND, 1))], axis=-1)
    low, high = (radius * ring + [0, 0, side * half] for side in (-1, 1))
    up = np.repeat([[0.0, 0.0, 1.0]], AROUND, axis=0)
    points = np.concatenate([low, high, low, high])
    normals = np.concatenate([ring, ring, -up, up])
    fan = np.stack(
        [np.zeros(AROUND - 2, int), np.arange(1, AROUND - 1), np.arange(2, AROUND)], axis=1
    )
    return points, normals, np.concatenate([_bands(2), fan[:, ::-1] + 2 * AROUND, fan + 3 * AROUND])


def _box(size: np.ndarray) -> Parts:
    points, normals, triangles = [], [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            normal = side * np.eye(3)[axis]
            across, along = np.eye(3)[(axis + 1) % 3], side * np.eye(3)[(axis + 2) % 3]
            corners = [
                normal + x * across + y * along for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
            ]
            first = 4 * len(triangles)
            points.append(np.array(corners) * size)
            normals.append(np.repeat(normal[None], 4, axis=0))
            triangles.append(np.array([[0, 1, 2], [0, 2, 3]]) + first)
    return np.concatenate(points), np.concatenate(normals), np.concatenate(triangles)


def _ring() -> np.ndarray:
    """Return (1, AROUND, 2) points of the unit circle."""
    angles = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)[None]


def _up() -> np.ndarray:
    return np.ones((1, AROUND, 1))


def _bands(rings: int) -> np.ndarray:
    """Return the triangles between `rings` rings of `AROUND` points, the lowest first."""
    low, following = np.arange(AROUND), np.roll(np.arange(AROUND), -1)
    one, other = (
        np.stack([low, following, low + AROUND], 1),
        np.stack([following, following + AROUND, low + AROUND], 1),
    )
    return np.concatenate(
        [np.concatenate([one, other]) + band * AROUND for band in range(rings - 1)]
    )


MAKERS = {
    "capsule": _capsule,
    "sphere": _sphere,
    "ellipsoid": _ellipsoid,
    "cylinder": _cylinder,
    "box": _box,
}
