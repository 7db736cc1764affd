"""Closed smooth surfaces, as points (V, 3) [m] and triangles (M, 3) counterclockwise from outside.

A tube or blade is lofted: rings of points are laid through its sections, and triangles between the rings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

POINTS_AROUND = 20
"""Number of points around a body: enough for sections to look round."""

RINGS_PER_SECTION = 3
"""Number of rings from one section of a body or fin to the next."""

CHORD = np.array([0.0, 0.12, 0.4, 0.75, 1.0])
"""Positions of points along a fin's section, from its leading edge, 0, to its trailing edge, 1."""

CHORD_THICKNESS = np.array([0.0, 0.75, 1.0, 0.55, 0.1])
"""Thickness at those points: round in front; blunt behind, so that each side has normals of its own."""

BALL_RINGS = 8
"""Number of rings of a ball from pole to pole, the poles included."""

BALL_POINTS_AROUND = 12
"""Number of points in each ring of a ball."""

BOX_ARC = np.tan(np.radians([15.0, 30.0, 45.0]))
"""Positions of points along a box's rounded edge, from the flat side to the middle of the edge, over its radius."""

BOX_FLAT = np.linspace(-1, 1, 5)
"""Positions of points along the flat side between two edges, -1 to 1."""

TIP_SIZE = 1e-9
"""Size below which a ring is a tip, and smallest length divided by [m]."""

MIN_AREA = TIP_SIZE**2
"""Smallest area that a normal is divided by [m²]."""


class Surface(NamedTuple):
    """A closed surface."""

    points: Float[np.ndarray, "V 3"]
    """Points of the surface [m]."""
    triangles: Int[np.ndarray, "M 3"]
    """Numbers of points, counterclockwise from outside."""


def joined(surfaces: Sequence[Surface]) -> Surface:
    """Return several surfaces as one."""
    points = []
    triangles = []
    first = 0
    for surface in surfaces:
        points.append(surface.points)
        triangles.append(surface.triangles + first)
        first += len(surface.points)
    return Surface(np.concatenate(points), np.concatenate(triangles))


def mirrored(surface: Surface) -> Surface:
    """Return the surface on the other side of the plane y = 0."""
    return Surface(surface.points * [1, -1, 1], surface.triangles[:, ::-1])


def normals_of(surface: Surface) -> Float[np.ndarray, "V 3"]:
    """Return outward unit normals at the points: of all triangles at a point, the larger ones counting more."""
    corners = surface.points[surface.triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(surface.points)
    for corner in range(3):
        np.add.at(total, surface.triangles[:, corner], areas)
    sizes = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.maximum(sizes, MIN_AREA)


def body_surface(sections: ArrayLike) -> Surface:
    """Return the smooth tube through elliptic `sections` (K, 4): x, half the width, top, bottom [m]."""
    x, half_width, top, bottom = _smooth(np.asarray(sections, float), _section_beyond).T
    angles = np.linspace(0, 2 * np.pi, POINTS_AROUND, endpoint=False)
    middle = (top + bottom) / 2
    half_height = np.abs(top - bottom) / 2
    along = np.repeat(x[:, None], POINTS_AROUND, axis=1)
    across = np.abs(half_width)[:, None] * np.cos(angles)
    upward = middle[:, None] + half_height[:, None] * np.sin(angles)
    return _lofted(np.stack([along, across, upward], axis=-1))


def fin_surface(edge: ArrayLike, thickness: float) -> Surface:
    """Return the blade behind the leading `edge` (K, 4): x, y, z, chord [m]; `thickness` is over the chord."""
    curve = _smooth(np.asarray(edge, float), _straight_beyond)
    points = curve[:, :3]
    chord = np.abs(curve[:, 3])
    along = np.gradient(points, axis=0)
    side = np.cross(along, [1.0, 0.0, 0.0])
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), TIP_SIZE)
    behind = np.concatenate([CHORD, CHORD[:0:-1]])
    off = np.concatenate([CHORD_THICKNESS, -CHORD_THICKNESS[:0:-1]]) * thickness / 2
    back = (chord[:, None] * behind)[..., None] * [-1.0, 0.0, 0.0]
    sideways = (chord[:, None] * off)[..., None] * side[:, None]
    return _lofted(points[:, None] + back + sideways)


def ball_surface(centre: Float[np.ndarray, " 3"], radius: float) -> Surface:
    """Return a ball around `centre` [m] whose poles lie along Y."""
    polar = np.linspace(0, np.pi, BALL_RINGS)[:, None]
    around = np.linspace(0, 2 * np.pi, BALL_POINTS_AROUND, endpoint=False)
    x = np.sin(polar) * np.cos(around)
    y = np.broadcast_to(np.cos(polar), x.shape)
    z = np.sin(polar) * np.sin(around)
    return _lofted(centre + radius * np.stack([x, y, z], axis=-1))


def box_surface(
    half: Float[np.ndarray, " 3"], radius: float
) -> tuple[Surface, Float[np.ndarray, "V 3"]]:
    """Return a box of half sides `half` [m] with edges rounded by `radius` [m], and its points on the sharp box.

    Those are -1 to 1 along every axis.
    """
    axes = [_box_axis(half_side, radius) for half_side in half]
    count = len(axes[0])
    indices = np.meshgrid(*[np.arange(count)] * 3, indexing="ij")
    grid = np.stack(indices, axis=-1).reshape(-1, 3)
    is_outside = ((grid == 0) | (grid == count - 1)).any(axis=1)
    outside = np.flatnonzero(is_outside)
    number = np.full(count**3, -1)
    number[outside] = np.arange(len(outside))
    sharp = np.stack([axes[axis][grid[outside, axis]] for axis in range(3)], axis=1)
    core = np.clip(sharp, radius - half, half - radius)
    away = sharp - core
    points = core + radius * away / np.linalg.norm(away, axis=1, keepdims=True)
    surface = Surface(points, number[_box_triangles(count)])
    return _outward(surface), sharp / half


def _box_axis(half: float, radius: float) -> Float[np.ndarray, " K"]:
    """Return the positions of the points of a box of half side `half` along one axis [m]: an edge, the flat side, an edge."""
    core = half - radius
    edge = core + radius * BOX_ARC
    other_edge = -(core + radius * BOX_ARC[::-1])
    return np.concatenate([other_edge, core * BOX_FLAT, edge])


def _box_triangles(count: int) -> Int[np.ndarray, "M 3"]:
    """Return the triangles of the six faces of a grid of `count`³ points, by their number in it."""
    steps = count ** np.arange(2, -1, -1)
    low = np.arange(count - 1)
    faces = []
    for axis in range(3):
        u = steps[(axis + 1) % 3]
        v = steps[(axis + 2) % 3]
        corner = (low[:, None] * u + low * v).ravel()
        quads = np.stack([corner, corner + u, corner + u + v, corner + v], axis=1)
        faces.append(quads[:, ::-1])
        faces.append(quads + (count - 1) * steps[axis])
    quads = np.concatenate(faces)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


Beyond = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function from the last row of a curve and the one before it to the row beyond the end."""


def _section_beyond(end: Float[np.ndarray, " 4"], inner: Float[np.ndarray, " 4"]) -> np.ndarray:
    """Return the section beyond the end of a body: past a tip, the opposite side, so that the tip is round."""
    _, half_width, top, bottom = end
    is_tip = abs(half_width) <= TIP_SIZE and abs(top - bottom) <= TIP_SIZE
    if not is_tip:
        return _straight_beyond(end, inner)
    return np.array([inner[0], -inner[1], inner[3], inner[2]])


def _straight_beyond(end: Float[np.ndarray, " D"], inner: Float[np.ndarray, " D"]) -> np.ndarray:
    return 2 * end - inner


def _smooth(rows: Float[np.ndarray, "K D"], beyond: Beyond) -> Float[np.ndarray, "R D"]:
    """Return rows on a centripetal Catmull-Rom curve through `rows`; `beyond` extends it at both ends.

    It is the cubic with the slopes of Barry and Goldman's pyramid (1988).
    """
    from scipy.interpolate import CubicHermiteSpline  # it takes long to import

    before = beyond(rows[0], rows[1])
    after = beyond(rows[-1], rows[-2])
    knots = np.concatenate([[before], rows, [after]])
    distances = np.maximum(np.linalg.norm(np.diff(knots, axis=0), axis=1), TIP_SIZE)
    times = np.concatenate([[0.0], np.cumsum(np.sqrt(distances))])
    slopes = np.diff(knots, axis=0) / np.diff(times)[:, None]
    over_two = (knots[2:] - knots[:-2]) / (times[2:] - times[:-2])[:, None]
    curve = CubicHermiteSpline(times[1:-1], rows, slopes[:-1] + slopes[1:] - over_two)
    between = np.linspace(times[1:-2], times[2:-1], RINGS_PER_SECTION, endpoint=False, axis=1)
    return np.concatenate([curve(between.ravel()), rows[-1:]])


def _lofted(rings: Float[np.ndarray, "K R 3"]) -> Surface:
    """Return the closed surface through `rings`; each end is a tip or closed by a fan of triangles."""
    first = 1 if _is_tip(rings[0]) else 0
    end = len(rings) - 1 if _is_tip(rings[-1]) else len(rings)
    open_rings = rings[first:end]
    count, size = open_rings.shape[:2]
    here = np.arange(size)
    following = np.roll(here, -1)
    front = np.full(size, count * size)
    rear = front + 1
    last_ring = size * (count - 1)
    front_fan = np.stack([following, here, front], axis=1)
    rear_fan = np.stack([here + last_ring, following + last_ring, rear], axis=1)
    ring_points = open_rings.reshape(-1, 3)
    tips = np.stack([rings[0].mean(axis=0), rings[-1].mean(axis=0)])
    points = np.concatenate([ring_points, tips])
    triangles = np.concatenate([bands_between(count, size), front_fan, rear_fan])
    return _outward(Surface(points, triangles))


def bands_between(rings: int, size: int) -> Int[np.ndarray, "M 3"]:
    """Return the triangles between `rings` rings of `size` points each, the first ring's points numbered first."""
    here = np.arange(size)
    following = np.roll(here, -1)
    lower = np.stack([here, following, here + size], axis=1)
    upper = np.stack([following, following + size, here + size], axis=1)
    band = np.concatenate([lower, upper])
    return np.concatenate([band + size * ring for ring in range(rings - 1)])


def _is_tip(ring: Float[np.ndarray, "R 3"]) -> bool:
    return bool(np.ptp(ring, axis=0).max() < TIP_SIZE)


def _outward(surface: Surface) -> Surface:
    """Return the surface with its triangles turned so that it encloses a positive volume."""
    corners = surface.points[surface.triangles]
    volume = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum()
    if volume >= 0:
        return surface
    return Surface(surface.points, surface.triangles[:, ::-1])
