"""Checks of a deformable body's faces, which refuse those without area and those that look into the body."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.errors import ArgumentError

MIN_FACE_AREA = 1e-12
"""Minimum area of a face [m²]: a smaller one has no direction to look in."""

FLAT = 1e-9
"""Height over area below which a skin is flat [m]: it encloses no volume that could tell inside from outside."""

MIN_CORNERS = 3
"""Minimum number of different corners of a face with an area."""

Ring = list[int]
"""The different corners of a face, in order."""


def check_faces(
    faces: Sequence[Sequence[str]],
    positions: Float[np.ndarray, "N 3"],
    corners: Int[np.ndarray, "F 4"],
) -> None:
    """Refuse faces without area, and faces that look into the body.

    A face that is there from both sides is a fin's and may look anywhere. `faces` are the corners as
    written down, for the message; `corners` the same as numbers of mass points.
    """
    p = positions[corners]
    areas = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1]) / 2
    rings = [list(dict.fromkeys(face)) for face in corners.tolist()]
    for face, ring, area in zip(faces, rings, areas, strict=True):
        if len(ring) < MIN_CORNERS or np.linalg.norm(area) < MIN_FACE_AREA:
            raise ArgumentError(
                f"faces: {list(face)} has no area. Name three or four corners that are not in a line."
            )
    middles = np.array([positions[ring].mean(axis=0) for ring in rings]).reshape(-1, 3)
    inward = _inward_faces(rings, areas, middles, positions.mean(axis=0))
    for number, face in enumerate(faces):
        if number in inward:
            raise ArgumentError(
                f"faces: {list(face)} looks inward. List its corners counterclockwise from outside."
            )


def _inward_faces(
    rings: Sequence[Ring],
    areas: Float[np.ndarray, "F 3"],
    middles: Float[np.ndarray, "F 3"],
    centre: Float[np.ndarray, " 3"],
) -> set[int]:
    """Return the faces that look inward, of those that are there from one side only."""
    sides = Counter(frozenset(ring) for ring in rings)
    single = [face for face, ring in enumerate(rings) if sides[frozenset(ring)] == 1]
    neighbours = _neighbours(rings, single)
    inward: set[int] = set()
    remaining = set(single)
    while remaining:
        signs = _signs_in_skin(min(remaining), neighbours)
        remaining -= set(signs)
        inward |= _volume_reducing(signs, areas, middles, centre)
    return inward


def _neighbours(rings: Sequence[Ring], single: Sequence[int]) -> dict[int, list[tuple[int, bool]]]:
    """Return per face those it shares an edge with, and whether one of the two looks to the other side.

    Faces that look to the same side run along their common edge in opposite directions.
    """
    edges: dict[frozenset[int], list[tuple[int, bool]]] = {}
    for face in single:
        ring = rings[face]
        for start, end in zip(ring, ring[1:] + ring[:1], strict=True):
            edges.setdefault(frozenset((start, end)), []).append((face, start < end))
    neighbours: dict[int, list[tuple[int, bool]]] = {face: [] for face in single}
    for around in edges.values():
        if len(around) == 2:
            (first, first_ascends), (second, second_ascends) = around
            is_reversed = first_ascends == second_ascends
            neighbours[first].append((second, is_reversed))
            neighbours[second].append((first, is_reversed))
    return neighbours


def _signs_in_skin(start: int, neighbours: dict[int, list[tuple[int, bool]]]) -> dict[int, int]:
    """Return the faces connected to `start`, each with 1 if it looks to the same side and -1 if to the other."""
    signs = {start: 1}
    border = [start]
    while border:
        face = border.pop()
        for other, is_reversed in neighbours[face]:
            if other not in signs:
                signs[other] = -signs[face] if is_reversed else signs[face]
                border.append(other)
    return signs


def _volume_reducing(
    signs: dict[int, int],
    areas: Float[np.ndarray, "F 3"],
    middles: Float[np.ndarray, "F 3"],
    centre: Float[np.ndarray, " 3"],
) -> set[int]:
    """Return those of a connected skin's faces that make its volume smaller; of a flat one's, seen from `centre`."""
    numbers = np.array(list(signs))
    signed_areas = areas[numbers] * np.array(list(signs.values()))[:, None]
    arms = middles[numbers] - middles[numbers].mean(axis=0)
    volume = np.sum(signed_areas * arms)
    if abs(volume) < FLAT * np.abs(areas[numbers]).sum():
        volume = np.sum(signed_areas * (middles[numbers] - centre))
    return {face for face, sign in signs.items() if sign * volume < 0}
