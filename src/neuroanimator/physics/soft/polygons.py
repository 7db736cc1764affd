"""A surface of polygons as triangles: vertices at one place are one, faces meet corner to corner, ears are clipped.

Convex faces become fans. Others lose ears, the best-shaped first (Meisters, Polygons Have Ears, 1975), in the plane
closest to them (Newell's normal). All steps but the last work on all faces at once.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.appearance.shapes import MAX_NODES
from neuroanimator.errors import BadFileError
from neuroanimator.physics.soft.mesh import Mesh, named_lines
from neuroanimator.physics.soft.soft_body import Points

WELD = 1e-6
"""Distance at which vertices are one, and a vertex lies on an edge, over the size of the mesh: six digits of a file."""

MIN_SIZE = 1e-9
"""Minimum area or volume of an element, over the square or cube of the mesh's size."""

BENT = 1000.0
"""Doubled area at a corner, over the least one of a face, from which a face without area is no line, but a bow tie."""

MIN_SHAPE = 1e-5
"""Minimum ratio of a triangle's doubled area to the sum of its squared edges; 0.58 if it is equilateral."""

MAX_CORNERS = 256
"""Maximum number of corners of a face, with those that lie on its edges: time grows with the square."""

MAX_TRIANGLES = 4 * MAX_NODES
"""Maximum number of triangles: twice as many as nodes is usual."""

MAX_IN_EDGE = 64
"""Maximum number of vertices that lie on an edge: each is a pass over all edges."""

MAX_EDGES_BESIDE = 8
"""Maximum number of an edge's neighbours at a vertex among which the one that lies on it is looked for."""


Outlines = Float[np.ndarray, "*P C 2"]
"""Corners of polygons in their planes."""

FaceNumbers = Int[np.ndarray, " F"]
"""A number for each polygon."""

CornerNumbers = Int[np.ndarray, " K"]
"""A number for each corner of all polygons."""


class Faces(NamedTuple):
    """Polygons: their corners one after the other."""

    corners: CornerNumbers
    owners: CornerNumbers
    """Number of the polygon each corner belongs to, ascending."""

    @property
    def following(self) -> CornerNumbers:
        """Index of the next corner of the same polygon."""
        following = np.arange(1, len(self.owners) + 1)
        _, first, counts = np.unique(self.owners, return_index=True, return_counts=True)
        following[first + counts - 1] = first
        return following

    def without(self, is_left_out: Bool[np.ndarray, " K"]) -> Faces:
        return Faces(self.corners[~is_left_out], self.owners[~is_left_out])


def triangulated(name: str, positions: Points, polygons: list[list[int]], lines: list[int]) -> Mesh:
    """Return the mesh of the polygons on these `lines` of a file, in their order; BadFileError names what is no polygon."""
    sizes = np.array([len(polygon) for polygon in polygons])
    of_lines = np.array(lines)
    faces = Faces(np.concatenate(polygons).astype(int), np.repeat(np.arange(len(polygons)), sizes))
    low = positions.min(axis=0)
    extent = float((positions.max(axis=0) - low).max())
    # vertices at one place are one
    cells = np.round((positions - low) / max(WELD * extent, np.finfo(float).tiny))
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    welded = first[cell.reshape(-1)]
    used = np.unique(faces.corners)
    faces = Faces(welded[faces.corners], faces.owners)
    faces = faces.without(faces.corners == faces.corners[faces.following])
    faces = faces.without(np.bincount(faces.owners, minlength=len(polygons))[faces.owners] < 3)
    # faces without area
    if len(faces.owners):
        faces = _with_area(name, positions, faces, of_lines, extent)
    flat = np.setdiff1d(np.arange(len(polygons)), faces.owners)
    if len(flat) == len(polygons):
        raise BadFileError(f"{name}: no face has an area. Export a surface as OBJ.")
    # faces meet corner to corner
    before = len(faces.corners)
    faces = _corner_to_corner(name, positions, faces, of_lines, WELD * extent)
    triangles, owners = _triangles(name, positions, faces, of_lines)
    nodes, elements = np.unique(triangles, return_inverse=True)
    told = (
        (len(used) - len(np.unique(welded[used])), "vertices at the place of others welded"),
        (len(positions) - len(used), "vertices without a face left out"),
        (len(flat), f"faces without area left out ({named_lines(of_lines[flat])})"),
        (len(faces.corners) - before, "corners put into edges on which they lie"),
    )
    mended = tuple(f"{count} {what}" for count, what in told if count)
    return Mesh(
        positions[nodes], elements.reshape(-1, 3), name, nodes + 1, of_lines[owners], mended
    )


def _with_area(
    name: str,
    positions: Points,
    faces: Faces,
    lines: FaceNumbers,
    extent: float,
) -> Faces:
    """Return the faces that have an area; BadFileError names one that has none though its corners are on no line."""
    following = faces.following
    owners, first = np.unique(faces.owners, return_index=True)
    turns = np.zeros(len(lines))
    places = positions[faces.corners]
    edges = places[following] - places
    bends = np.linalg.norm(np.cross(edges, edges[following]), axis=1)
    np.maximum.at(turns, faces.owners, bends)
    areas = np.zeros(len(lines))
    areas[owners] = np.linalg.norm(_normals(places, following, first), axis=1)
    least = 2 * MIN_SIZE * extent**2
    is_flat = areas < least
    crossed = np.flatnonzero(is_flat & (turns > BENT * least))
    if len(crossed):
        raise _crossed(name, lines[crossed])
    return faces.without(is_flat[faces.owners])


def _crossed(name: str, lines: Int[np.ndarray, " _"]) -> BadFileError:
    return BadFileError(
        f"{name}: {named_lines(lines)}: the edges of a face cross, or it folds over. Triangulate it where you made it."
    )


def _normals(
    places: Float[np.ndarray, "K 3"], following: CornerNumbers, first: FaceNumbers
) -> Float[np.ndarray, "F 3"]:
    """Return Newell's normal of each polygon, as long as its doubled area; `first` are their first corners."""
    counts = np.diff(np.append(first, len(places)))
    away = places - np.repeat(places[first], counts, axis=0)
    return np.add.reduceat(np.cross(away, away[following]), first)


def _corner_to_corner(
    name: str,
    positions: Points,
    faces: Faces,
    lines: FaceNumbers,
    tolerance: float,
) -> Faces:
    """Return the faces with the vertices that lie on an edge of only one face as corners of that face.

    Such an edge of a coarse face begins where the finer ones beside it do: at its end, one of them goes the same way.
    BadFileError names a face with too many.
    """
    passes = 0
    while True:
        following = faces.following
        ends = np.stack([faces.corners, faces.corners[following]], axis=1)
        edges = ends.min(axis=1) * len(positions) + ends.max(axis=1)
        _, first, counts = np.unique(edges, return_index=True, return_counts=True)
        open_edges = np.sort(first[counts == 1])
        near = ends[open_edges].T.ravel()
        far = ends[open_edges][:, ::-1].T.ravel()
        order = np.argsort(near, kind="stable")
        slots: list[np.ndarray] = []
        vertices: list[np.ndarray] = []
        for shift in range(1, MAX_EDGES_BESIDE):
            one = np.concatenate([order[:-shift], order[shift:]])
            other = np.concatenate([order[shift:], order[:-shift]])
            is_beside = near[one] == near[other]
            one = one[is_beside]
            other = other[is_beside]
            along = positions[far[one]] - positions[near[one]]
            away = positions[far[other]] - positions[near[one]]
            length = np.linalg.norm(along, axis=1)
            distance = np.linalg.norm(np.cross(along, away), axis=1) / length
            reached = (along * away).sum(axis=1) / length
            is_on = (distance <= tolerance) & (reached > 0) & (reached < length - tolerance)
            slots.append(open_edges[one[is_on] % len(open_edges)])
            vertices.append(far[other[is_on]])
        slot, place = np.unique(np.concatenate(slots), return_index=True)
        vertex = np.concatenate(vertices)[place]
        taken = faces.owners * len(positions) + faces.corners
        is_new = ~np.isin(faces.owners[slot] * len(positions) + vertex, taken)
        if not is_new.any():
            return faces
        if passes == MAX_IN_EDGE:
            raise BadFileError(
                f"{name}: {named_lines(lines[faces.owners[slot]])}: over {MAX_IN_EDGE} vertices lie on an edge of a face. "
                "Triangulate it where you made it."
            )
        passes += 1
        slot = slot[is_new]
        vertex = vertex[is_new]
        faces = Faces(
            np.insert(faces.corners, slot + 1, vertex),
            np.insert(faces.owners, slot + 1, faces.owners[slot]),
        )


def _triangles(
    name: str, positions: Points, faces: Faces, lines: FaceNumbers
) -> tuple[Int[np.ndarray, "T 3"], Int[np.ndarray, " T"]]:
    """Return (the triangles, the polygon of each), in the order of the polygons."""
    owners, first, counts = np.unique(faces.owners, return_index=True, return_counts=True)
    total = int((counts - 2).sum())
    if total > MAX_TRIANGLES:
        raise BadFileError(
            f"{name}: {total:,} triangles; wanted at most {MAX_TRIANGLES:,}. Make the mesh coarser."
        )
    if counts.max() > MAX_CORNERS:
        long = owners[counts > MAX_CORNERS]
        raise BadFileError(
            f"{name}: {named_lines(lines[long])}: a face of over {MAX_CORNERS} corners. Triangulate it where you made it."
        )
    normals = _normals(positions[faces.corners], faces.following, first)
    starts = np.cumsum(counts - 2) - (counts - 2)
    triangles = np.empty((total, 3), int)
    for size in np.unique(counts).tolist():
        alike = np.flatnonzero(counts == size)
        corners = faces.corners[first[alike][:, None] + np.arange(size)]
        places = _in_plane(positions[corners], normals[alike])
        local, is_sound = _triangles_of(places)
        if not is_sound.all():
            raise _crossed(name, lines[owners[alike[~is_sound]]])
        within = starts[alike][:, None] + np.arange(size - 2)
        triangles[within] = corners[np.arange(len(corners))[:, None, None], local]
    return triangles, np.repeat(owners, counts - 2)


def _in_plane(places: Float[np.ndarray, "P C 3"], normals: Float[np.ndarray, "P 3"]) -> Outlines:
    """Return coordinates in the planes across the `normals`, in which polygons run counterclockwise."""
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    least = np.eye(3)[np.abs(unit).argmin(axis=1)]
    across = np.cross(least, unit)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    axes = np.stack([across, np.cross(unit, across)], axis=2)
    return (places - places[:, :1]) @ axes


def _triangles_of(
    places: Outlines,
) -> tuple[Int[np.ndarray, "P T 3"], Bool[np.ndarray, " P"]]:
    """Return (triangles of each polygon, whether they all have an area): a fan if it is convex, else its ears."""
    rows, size, _ = places.shape
    steps = np.arange(1, size - 1)
    fan = np.stack([0 * steps, steps, steps + 1], axis=1)
    triangles = np.repeat(fan[None], rows, axis=0)
    of_corners = _shapes(np.roll(places, 1, axis=1), places, np.roll(places, -1, axis=1))
    of_fan = _shapes(places[:, fan[:, 2]], places[:, fan[:, 0]], places[:, fan[:, 1]])
    is_sound = np.minimum(of_corners.min(axis=1), of_fan.min(axis=1)) > MIN_SHAPE
    for hard in np.flatnonzero(~is_sound):
        ears = _ears(places[hard])
        is_sound[hard] = len(ears) == size - 2
        if is_sound[hard]:
            triangles[hard] = ears
    return triangles, is_sound


def _ears(outline: Outlines) -> list[Int[np.ndarray, " 3"]]:
    """Return the ears of a polygon, one after the other; fewer than it has triangles if the rest has none."""
    left = np.arange(len(outline))
    shapes = _shapes_of_ears(outline, left)
    ears: list[np.ndarray] = []
    while len(left) > 2:
        best = int(shapes.argmax())
        if shapes[best] <= MIN_SHAPE:
            break
        ears.append(left[[best - 1, best, (best + 1) % len(left)]])
        # without the ear: only its neighbours change, or all if none seems to be one any more
        left = np.delete(left, best)
        shapes = np.delete(shapes, best)
        beside = np.array([best - 1, best]) % len(left)
        shapes[beside] = _shapes_of_ears(outline[left], beside)
        if shapes.max() <= MIN_SHAPE:
            shapes = _shapes_of_ears(outline[left], np.arange(len(left)))
    return ears


def _shapes(first: Outlines, second: Outlines, third: Outlines) -> Float[np.ndarray, "*P C"]:
    """Return how good the triangles of three corners are, see `MIN_SHAPE`; negative for those that turn right."""
    before = second - first
    after = third - second
    squares = (before**2 + after**2 + (before + after) ** 2).sum(axis=-1)
    return _cross(before, after) / np.maximum(squares, np.finfo(float).tiny)


def _shapes_of_ears(outline: Outlines, at: Int[np.ndarray, " A"]) -> Float[np.ndarray, " A"]:
    """Return `_shapes` of the corners `at`, with 0 for one whose triangle has another corner in it or on it."""
    corners = [outline[(at + turn) % len(outline)] for turn in (-1, 0, 1)]
    sides = list(pairwise([*corners, corners[0]]))
    squares = np.sum([(end - start) ** 2 for start, end in sides], axis=(0, 2))
    is_inside = np.ones((len(at), len(outline)), bool)
    for start, end in sides:
        away = outline - start[:, None]
        along = _cross((end - start)[:, None], away)
        is_inside &= along > -MIN_SHAPE * squares[:, None]
        is_inside &= (away != 0).any(axis=-1)
    return np.where(is_inside.any(axis=1), 0.0, _shapes(*corners))


def _cross(
    first: Float[np.ndarray, "... 2"], second: Float[np.ndarray, "... 2"]
) -> Float[np.ndarray, " ..."]:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
