"""Checks of a deformable body's faces, which refuse faces without area and those that face inward."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.errors import ArgumentError

MIN_FACE_AREA = 1e-12
"""Minimum area of a face [m²]: a smaller one has no normal."""


def check_faces(
    faces: Sequence[Sequence[str]],
    positions: Float[np.ndarray, "N 3"],
    corners: Int[np.ndarray, "F 4"],
) -> None:
    """Refuse faces without area, neighbours that face opposite sides, and a skin that faces inward.

    A two-sided face is a fin's and may face anywhere. `faces` are the corners by name, for the message; `corners` the
    same as numbers of mass points.
    """
    p = positions[corners]
    areas = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1]) / 2
    for face, area in zip(faces, areas, strict=True):
        if np.linalg.norm(area) < MIN_FACE_AREA:
            raise ArgumentError(
                f"faces: {list(face)} has no area. Name three or four corners that are not in a line."
            )
    rings = [list(dict.fromkeys(face)) for face in corners.tolist()]
    sides = Counter(frozenset(ring) for ring in rings)
    single = [face for face, ring in enumerate(rings) if sides[frozenset(ring)] == 1]
    face_of: dict[tuple[int, int], int] = {}
    for face in single:
        ring = rings[face]
        for edge in zip(ring, ring[1:] + ring[:1], strict=True):
            # Faces to the same side run along their common edge in opposite directions.
            other = face_of.setdefault(edge, face)
            if other != face:
                raise ArgumentError(
                    f"faces: {list(faces[other])} and {list(faces[face])} face opposite sides. "
                    "List their corners counterclockwise from outside."
                )
    arms = p[single].mean(axis=1) - positions.mean(axis=0)
    if np.sum(areas[single] * arms) < 0:
        raise ArgumentError(
            f"faces: {list(faces[single[0]])} looks inward. List its corners counterclockwise from outside."
        )
