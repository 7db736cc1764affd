"""Simple shapes as triangles, in the frame of the bone they belong to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.appearance.loft import bands_between
from neuroanimator.appearance.skeleton import Shape
from neuroanimator.state.rotation import rotate

AROUND = 20
"""Number of points around a shape's axis: smooth at arm's length."""

ALONG = 12
"""Number of points from pole to pole: with those around, 240 points a capsule."""


class ShapeMesh(NamedTuple):
    """Triangles with their corners' normals."""

    points: Float[np.ndarray, "N 3"]
    """The corners [m]."""
    normals: Float[np.ndarray, "N 3"]
    """The outward unit vector at each corner."""
    triangles: Int[np.ndarray, "M 3"]
    """The corners of each triangle, counterclockwise from outside."""


def shape_mesh(shape: Shape) -> ShapeMesh:
    """Return the triangles of `shape`."""
    mesh = MAKERS[shape.kind](np.array(shape.size))
    orientation = np.broadcast_to(np.array(shape.orientation), (len(mesh.points), 4))
    points = rotate(orientation, mesh.points) + np.array(shape.position)
    normals = rotate(orientation, mesh.normals)
    return ShapeMesh(points, normals, mesh.triangles)


def _rounded(axes: Float[np.ndarray, " 3"], half_length: float) -> ShapeMesh:
    """Return an ellipsoid of half axes `axes`, its halves moved apart along Z by `half_length` each way."""
    latitudes = np.linspace(-np.pi / 2, np.pi / 2, ALONG)[:, None, None]
    rings = np.cos(latitudes) * _circle()
    heights = np.sin(latitudes) * np.ones((AROUND, 1))
    unit = np.concatenate([rings, heights], axis=-1)
    shift = np.where(latitudes < 0, -half_length, half_length)
    points = unit * axes + shift * [0, 0, 1]
    normals = unit / axes
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    triangles = bands_between(ALONG, AROUND)
    return ShapeMesh(points.reshape(-1, 3), normals.reshape(-1, 3), triangles)


def _cylinder(size: Float[np.ndarray, " D"]) -> ShapeMesh:
    """Return the side and two caps; corners are doubled where the surface has an edge."""
    radius = size[0]
    half_length = size[1]
    ring = np.concatenate([_circle(), np.zeros((AROUND, 1))], axis=-1)
    low = radius * ring + [0, 0, -half_length]
    high = radius * ring + [0, 0, half_length]
    up = np.repeat([[0.0, 0.0, 1.0]], AROUND, axis=0)
    points = np.concatenate([low, high, low, high])
    normals = np.concatenate([ring, ring, -up, up])
    upper_cap = _fan()
    lower_cap = upper_cap[:, ::-1]
    triangles = [bands_between(2, AROUND), lower_cap + 2 * AROUND, upper_cap + 3 * AROUND]
    return ShapeMesh(points, normals, np.concatenate(triangles))


def _box(size: Float[np.ndarray, " 3"]) -> ShapeMesh:
    points = []
    normals = []
    triangles = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            normal = side * np.eye(3)[axis]
            across = np.eye(3)[(axis + 1) % 3]
            along = side * np.eye(3)[(axis + 2) % 3]
            corners = np.array(
                [
                    normal - across - along,
                    normal + across - along,
                    normal + across + along,
                    normal - across + along,
                ]
            )
            first = 4 * len(triangles)
            points.append(corners * size)
            normals.append(np.repeat(normal[None], 4, axis=0))
            triangles.append(np.array([[0, 1, 2], [0, 2, 3]]) + first)
    return ShapeMesh(np.concatenate(points), np.concatenate(normals), np.concatenate(triangles))


def _circle() -> Float[np.ndarray, "N 2"]:
    """Return `AROUND` points of the unit circle."""
    angles = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def _fan() -> Int[np.ndarray, "M 3"]:
    """Return the triangles that fill a ring of `AROUND` points, all from its first point."""
    first = np.zeros(AROUND - 2, int)
    return np.stack([first, np.arange(1, AROUND - 1), np.arange(2, AROUND)], axis=1)


MAKERS = {
    "capsule": lambda size: _rounded(np.full(3, size[0]), size[1]),
    "sphere": lambda size: _rounded(np.full(3, size[0]), 0.0),
    "ellipsoid": lambda size: _rounded(size, 0.0),
    "cylinder": _cylinder,
    "box": _box,
}
"""Function that makes the triangles of each kind of shape from its sizes."""
