"""Closed smooth surfaces, as points (V, 3) [m] and triangles (M, 3) counterclockwise from outside."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

AROUND = 20
"""Points around a body."""
BETWEEN = 3
"""Rings from one section of a body or fin to the next."""
CHORD = np.array([0.0, 0.12, 0.4, 0.75, 1.0])
"""Where a fin's section has points, from its leading edge, 0, to its trailing edge, 1."""
CHORD_THICKNESS = np.array([0.0, 0.75, 1.0, 0.55, 0.1])
"""How thick it is there: round in front; blunt behind, so that each side has normals of its own."""
SMALLEST = 1e-9
"""[m] A ring smaller than this is a tip."""


class Surface(NamedTuple):
    """A closed surface."""

    points: np.ndarray
    triangles: np.ndarray


def joined(surfaces: list[Surface]) -> Surface:
    """Return several surfaces as one."""
    firsts = np.cumsum([0, *(len(surface.points) for surface in surfaces)])
    triangles = [
        surface.triangles + first for surface, first in zip(surfaces, firsts, strict=False)
    ]
    return Surface(
        np.concatenate([surface.points for surface in surfaces]), np.concatenate(triangles)
    )


def normals_of(surface: Surface) -> np.ndarray:
    """Return outward unit normals (V, 3): of all triangles at a point, the larger ones counting more."""
    corners = surface.points[surface.triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(surface.points)
    for corner in range(3):
        np.add.at(total, surface.triangles[:, corner], areas)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), SMALLEST**2)


def body_surface(sections: np.ndarray) -> Surface:
    """Return the smooth tube through elliptic `sections` (K, 4): x, half the width, top, bottom."""
    x, width, top, bottom = _smooth(np.asarray(sections, float), _beyond).T
    angles = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    across = np.abs(width)[:, None] * np.cos(angles)
    upward = ((top + bottom) / 2)[:, None] + np.abs(top - bottom)[:, None] / 2 * np.sin(angles)
    return _lofted(np.stack([np.repeat(x[:, None], AROUND, axis=1), across, upward], axis=-1))


def fin_surface(edge: np.ndarray, thickness: float) -> Surface:
    """Return the blade behind the leading `edge` (K, 4): x, y, z, chord; `thickness` over chord."""
    curve = _smooth(np.asarray(edge, float), lambda end, latent: 2 * end - latent)
    points, chord = curve[:, :3], np.abs(curve[:, 3])
    along = np.gradient(points, axis=0)
    side = np.cross(along, [1.0, 0.0, 0.0])
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), SMALLEST)
    behind = np.concatenate([CHORD, CHORD[:0:-1]])
    off = np.concatenate([CHORD_THICKNESS, -CHORD_THICKNESS[:0:-1]]) * thickness / 2
    back = (chord[:, None] * behind)[..., None] * [-1.0, 0.0, 0.0]
    return _lofted(points[:, None] + back + (chord[:, None] * off)[..., None] * side[:, None])


def ball_surface(centre: np.ndarray, radius: float) -> Surface:
    """Return a ball whose poles lie along Y."""
    polar = np.linspace(0, np.pi, 8)[:, None]
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    parts = np.broadcast_arrays(
        np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)
    )
    return _lofted(centre + radius * np.stack(parts, axis=-1))


def box_surface(half: np.ndarray, radius: float) -> tuple[Surface, np.ndarray]:
    """Return a box of half sides `half` (3,) with rounded edges, and the points (V, 3), -1 to 1, on the sharp one."""
    arc = np.tan(np.radians([15.0, 30.0, 45.0]))
    flat = np.linspace(-1, 1, 5)
    axes = [np.concatenate([-(h - radius + radius * arc[::-1]), (h - radius) * flat, h - radius + radius * arc])
            for h in half]  # fmt: skip
    count = len(axes[0])
    grid = np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    outside = np.flatnonzero(((grid == 0) | (grid == count - 1)).any(axis=1))
    number = np.full(count**3, -1)
    number[outside] = np.arange(len(outside))
    sharp = np.stack([axes[axis][grid[outside, axis]] for axis in range(3)], axis=1)
    core = np.clip(sharp, radius - half, half - radius)
    away = sharp - core
    points = core + radius * away / np.linalg.norm(away, axis=1, keepdims=True)
    return _outward(Surface(points, number[_box_triangles(count)])), sharp / half


def mirrored(surface: Surface) -> Surface:
    """Return the surface on the other side of the plane y = 0."""
    return Surface(surface.points * [1, -1, 1], surface.triangles[:, ::-1])


def _box_triangles(count: int) -> np.ndarray:
    """Return the triangles of the six faces of a grid of `count`³ points, by their number in it."""
    steps = count ** np.arange(2, -1, -1)
    low = np.arange(count - 1)
    found = []
    for axis in range(3):
        u, v = steps[(axis + 1) % 3], steps[(axis + 2) % 3]
        corner = (low[:, None] * u + low * v).ravel()
        quads = np.stack([corner, corner + u, corner + u + v, corner + v], axis=1)
        found += [quads[:, ::-1], quads + (count - 1) * steps[axis]]
    quads = np.concatenate(found)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _smooth(rows: np.ndarray, beyond: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """Return rows on a centripetal Catmull-Rom curve through `rows` (K, D); `beyond` extends it at both ends."""
    knots = np.concatenate([[beyond(rows[0], rows[1])], rows, [beyond(rows[-1], rows[-2])]])
    ways = np.maximum(np.linalg.norm(np.diff(knots, axis=0), axis=1), SMALLEST)
    at = np.concatenate([[0.0], np.cumsum(np.sqrt(ways))])
    found = []
    for i in range(1, len(knots) - 2):
        times = np.linspace(at[i], at[i + 1], BETWEEN, endpoint=False)[:, None]
        found.append(_catmull_rom(knots[i - 1 : i + 3], at[i - 1 : i + 3], times))
    return np.concatenate([*found, rows[-1:]])


def _catmull_rom(knots: np.ndarray, at: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the curve between the middle two of four `knots` by Barry and Goldman's pyramid (1988)."""
    level = list(knots)
    for reach in (1, 2, 3):
        following = []
        for i in range(4 - reach):
            first, last = (at[i], at[i + reach]) if reach < 3 else (at[1], at[2])
            following.append(
                (level[i] * (last - times) + level[i + 1] * (times - first)) / (last - first)
            )
        level = following
    return level[0]


def _beyond(end: np.ndarray, latent: np.ndarray) -> np.ndarray:
    """Return the section beyond the end of a body: through a tip the other side comes out, so that it is round."""
    if abs(end[1]) > SMALLEST or abs(end[2] - end[3]) > SMALLEST:
        return 2 * end - latent
    return np.array([latent[0], -latent[1], latent[3], latent[2]])


def _lofted(rings: np.ndarray) -> Surface:
    """Return the closed surface through `rings` (K, R, 3); each end is a tip or closed by a fan of triangles."""
    first, last = rings[0], rings[-1]
    latent = rings[
        int(np.ptp(first, axis=0).max() < SMALLEST) : len(rings)
        - int(np.ptp(last, axis=0).max() < SMALLEST)
    ]
    count, size = latent.shape[:2]
    here, following = np.arange(size), np.roll(np.arange(size), -1)
    band = np.concatenate([
        np.stack([here, following, here + size], axis=1),
        np.stack([following, following + size, here + size], axis=1),
    ])  # fmt: skip
    bands = np.concatenate([band + size * k for k in range(count - 1)])
    front, rear = count * size, count * size + 1
    start = np.stack([following, here, np.full(size, front)], axis=1)
    last_ring = size * (count - 1)
    end = np.stack([here + last_ring, following + last_ring, np.full(size, rear)], axis=1)
    points = np.concatenate(
        [latent.reshape(-1, 3), first.mean(axis=0)[None], last.mean(axis=0)[None]]
    )
    return _outward(Surface(points, np.concatenate([bands, start, end])))


def _outward(surface: Surface) -> Surface:
    """Return the surface with its triangles turned so that it encloses a positive volume."""
    corners = surface.points[surface.triangles]
    volume = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum()
    return surface if volume >= 0 else Surface(surface.points, surface.triangles[:, ::-1])
