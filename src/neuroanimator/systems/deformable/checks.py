"""What is refused in a deformable body's definition, by name and before anything is simulated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from neuroanimator.errors import ArgumentError
from neuroanimator.systems.deformable.body import Body, largest_step

if TYPE_CHECKING:
    from neuroanimator.definitions.body import BodyDefinition

SHORTEST = 1e-9
"""[m] Two mass points closer than this are at one place."""
MIN_FACE = 1e-12
"""[m²] A face smaller than this has no area."""
MAX_LISTED = 12
"""Names an error lists at most."""
RK4_OVER_SYMPLECTIC = 1.3
"""How many times as large a step rk4 bears at least, whatever the damping (1.39 to 1.41)."""
MAX_SHORTENING = 0.9
"""Share of its length by which all muscles together may shorten a spring."""
MIRROR_TOLERANCE = 1e-9
"""Relative: left and right are the same to within rounding."""


def check_nodes(definition: BodyDefinition, most: int) -> None:
    """Refuse too many mass points, and any without mass."""
    if len(definition.nodes) > most:
        raise ArgumentError(
            f"nodes: wanted at most {most}, came {len(definition.nodes)}. Use a coarser body."
        )
    for name, (*_, mass) in definition.nodes.items():
        if mass <= 0:
            raise ArgumentError(
                f"nodes.{name}: wanted [x, y, z, mass] with a mass above 0 kg, came {mass:g} kg. "
                "Give it its share of the body's mass."
            )


def check_springs(
    names: Sequence[str], positions: np.ndarray, springs: np.ndarray, most: int
) -> None:
    """Refuse too many springs, springs without length, doubled ones, and a body in several pieces."""
    if len(springs) > most:
        raise ArgumentError(
            f"springs: wanted at most {most}, came {len(springs)}. Use a coarser body."
        )
    lengths = np.linalg.norm(positions[springs[:, 1]] - positions[springs[:, 0]], axis=1)
    seen = set()
    for ends, length in zip(springs, lengths, strict=True):
        pair = [names[i] for i in ends]
        if length < SHORTEST:
            raise ArgumentError(
                f"springs: {pair} has no length at rest: both ends are at one place. Move one, or leave it out."
            )
        if frozenset(ends) in seen:
            raise ArgumentError(
                f"springs: {pair} is there twice. Leave one out, or add up their stiffness."
            )
        seen.add(frozenset(ends))
    pieces = _pieces(len(names), springs)
    if len(pieces) > 1:
        smallest = min(pieces, key=len)
        raise ArgumentError(
            f"springs: the body is in {len(pieces)} pieces; no spring connects {listed(names[i] for i in smallest)} "
            "to the rest. Add springs, or make it a body of its own."
        )


def check_muscles(names: Sequence[str], springs: np.ndarray, shorten: np.ndarray) -> None:
    """Refuse muscles (P, M) that together leave a spring next to nothing of its length."""
    total = shorten.sum(axis=1)
    if (total > MAX_SHORTENING).any():
        worst = int(np.argmax(total))
        raise ArgumentError(
            f"muscles.shorten: the muscles together shorten {[names[i] for i in springs[worst]]} by {total[worst]:g} "
            f"of its length; wanted at most {MAX_SHORTENING:g}. Shorten less, or give each its own spring."
        )


def check_faces(faces: Sequence[Sequence[str]], positions: np.ndarray, corners: np.ndarray) -> None:
    """Refuse faces without area, and faces that look into the body.

    A face that is there from both sides is a fin's and may look anywhere.
    """
    p = positions[corners]
    areas = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1]) / 2
    rings = [list(dict.fromkeys(face)) for face in corners.tolist()]
    sides = Counter(frozenset(ring) for ring in rings)
    for face, ring, area in zip(faces, rings, areas, strict=True):
        if len(ring) < 3 or np.linalg.norm(area) < MIN_FACE:
            raise ArgumentError(
                f"faces: {list(face)} has no area. Name three or four corners that are not in a line."
            )
    single = [i for i, ring in enumerate(rings) if sides[frozenset(ring)] == 1]
    middles = np.array([positions[ring].mean(axis=0) for ring in rings]).reshape(-1, 3)
    inward = _looking_inward(rings, single, areas, middles, positions.mean(axis=0))
    for number, face in enumerate(faces):
        if number in inward:
            raise ArgumentError(
                f"faces: {list(face)} looks inward. List its corners counterclockwise from outside."
            )


def _looking_inward(
    rings: list[list[int]],
    single: list[int],
    areas: np.ndarray,
    middles: np.ndarray,
    centre: np.ndarray,
) -> set[int]:
    """Return the faces that look inward, of those in `single`."""
    neighbours, found, left = _neighbours(rings, single), set(), set(single)
    while left:
        signs, border = {min(left): 1}, [min(left)]
        while border:
            face = border.pop()
            for other, is_against in neighbours[face]:
                if other not in signs:
                    signs[other] = -signs[face] if is_against else signs[face]
                    border.append(other)
        left -= set(signs)
        found |= _negative(signs, areas, middles, centre)
    return found


def _neighbours(rings: list[list[int]], single: list[int]) -> dict[int, list[tuple[int, bool]]]:
    """Return per face those it shares an edge with, and whether one of the two looks the wrong way.

    Faces that look the same way run along their common edge in opposite directions.
    """
    edges: dict[frozenset[int], list[tuple[int, bool]]] = {}
    for face in single:
        for start, end in zip(rings[face], rings[face][1:] + rings[face][:1], strict=True):
            edges.setdefault(frozenset((start, end)), []).append((face, start < end))
    neighbours: dict[int, list[tuple[int, bool]]] = {face: [] for face in single}
    for around in edges.values():
        if len(around) == 2:
            (one, way), (other, other_way) = around
            neighbours[one].append((other, way == other_way))
            neighbours[other].append((one, way == other_way))
    return neighbours


def _negative(
    signs: dict[int, int], areas: np.ndarray, middles: np.ndarray, centre: np.ndarray
) -> set[int]:
    """Return those of a connected skin's faces that make its volume smaller; of a flat one's, seen from `centre`."""
    numbers = np.array(list(signs))
    signed = areas[numbers] * np.array(list(signs.values()))[:, None]
    reach = middles[numbers] - middles[numbers].mean(axis=0)
    if abs(volume := np.sum(signed * reach)) < SHORTEST * np.abs(areas[numbers]).sum():
        volume = np.sum(signed * (middles[numbers] - centre))
    return {face for face, sign in signs.items() if sign * volume < 0}


def check_mirror(body: Body, nodes: np.ndarray, controls: np.ndarray, names: Sequence[str]) -> None:
    """Refuse a mirror that is not one: reversing Y must give the same body under the same controls.

    `nodes` (N,) and `controls` (C,) are the partners, `names` those of the controls.
    """
    across, size = np.array([1.0, -1.0, 1.0]), np.ptp(body.positions, axis=0).max()
    seen = np.abs(body.positions[nodes] - body.positions * across).max(axis=1)
    for i in np.flatnonzero(seen > MIRROR_TOLERANCE * size)[:1].tolist():
        wanted, came = (
            (position + 0.0).tolist()
            for position in (body.positions[i] * across, body.positions[nodes[i]])
        )
        raise ArgumentError(
            f"mirror: '{body.names[i]}' needs a partner at {wanted}, but '{body.names[int(nodes[i])]}' is at {came}. "
            "Move one, or name the other."
        )
    for i in np.flatnonzero(
        ~np.isclose(body.masses[nodes], body.masses, rtol=MIRROR_TOLERANCE, atol=0)
    )[:1].tolist():
        raise ArgumentError(
            f"mirror: '{body.names[i]}' has {body.masses[i]:g} kg and its partner '{body.names[int(nodes[i])]}' "
            f"{body.masses[nodes[i]]:g} kg. Give both the same mass."
        )
    _check_mirrored_springs(body, nodes, controls, names)
    _check_mirrored_faces(body, nodes)
    pushed = np.abs(body.external_forces[:, controls] - body.external_forces * across[:, None]).max(
        axis=0
    )
    for c in np.flatnonzero(
        pushed > MIRROR_TOLERANCE * np.abs(body.external_forces).max(initial=0)
    )[:1].tolist():
        raise ArgumentError(
            f"mirror: reversing Y, the external force '{names[c]}' does not become that of '{names[int(controls[c])]}'. "
            "Make them mirror images, or leave out the mirror."
        )


def _check_mirrored_springs(
    body: Body, nodes: np.ndarray, controls: np.ndarray, names: Sequence[str]
) -> None:
    numbers = {frozenset(ends): p for p, ends in enumerate(body.springs.tolist())}
    for p, ends in enumerate(body.springs.tolist()):
        partners = nodes[ends].tolist()
        pair, wanted = ([body.names[i] for i in both] for both in (ends, partners))
        other = numbers.get(frozenset(partners))
        if other is None:
            raise ArgumentError(
                f"mirror: spring {pair} has no partner {wanted}. Add it, or leave out the mirror."
            )
        for what, numbers_of in (("stiffness", body.stiffness), ("damping", body.damping)):
            if not np.isclose(numbers_of[p], numbers_of[other], rtol=MIRROR_TOLERANCE, atol=0):
                raise ArgumentError(
                    f"mirror: spring {pair} has {what} {numbers_of[p]:g} and its partner {wanted} "
                    f"{numbers_of[other]:g}. Make them the same."
                )
        muscles = body.muscles[other, controls[: body.muscles.shape[1]]]
        for c in np.flatnonzero(muscles != body.muscles[p])[:1].tolist():
            raise ArgumentError(
                f"mirror: muscle '{names[c]}' shortens {pair} by {body.muscles[p, c]:g}, but its partner "
                f"'{names[int(controls[c])]}' shortens {wanted} by {body.muscles[other, controls[c]]:g}. "
                "Name the other partner, or the mirrored springs."
            )


def _check_mirrored_faces(body: Body, nodes: np.ndarray) -> None:
    there = Counter(_ring(face) for face in body.faces.tolist())
    mirrored = Counter(_ring(nodes[face][::-1].tolist()) for face in body.faces)
    for ring in mirrored - there:
        raise ArgumentError(
            f"mirror: a face is missing: {[body.names[i] for i in ring]}, the mirror image of one that is there. "
            "Add it, or leave out the mirror."
        )


def _ring(corners: Sequence[int]) -> tuple[int, ...]:
    """Return the corners from the smallest one on, in the same sense."""
    ring = list(dict.fromkeys(corners))
    first = ring.index(min(ring))
    return tuple(ring[first:] + ring[:first])


def check_steps(definition: BodyDefinition, body: Body) -> None:
    """Refuse a step at which the body's own small vibrations would grow."""
    physics, limit = definition.physics, largest_step(body)
    for key in ("step", "truth_step", "fine_step"):
        step, integrator = (
            getattr(physics, key),
            getattr(physics, key.replace("step", "integrator")),
        )
        most = limit * (RK4_OVER_SYMPLECTIC if integrator == "rk4" else 1.0)
        if step > most:
            why = (
                "its matrix holds nothing of a spring at rest"
                if integrator == "semi-implicit"
                else "they grow"
            )
            raise ArgumentError(
                f"physics.{key}: {step:g} s is too large for the fastest vibrations: {integrator} needs at most "
                f"{most:.3g} s ({why}). Take a smaller step, softer springs or more mass."
            )


def listed(names: Iterable[str]) -> str:
    """Return the names with commas; of very many the first ones."""
    every = list(names)
    rest = f" and {len(every) - MAX_LISTED} more" if len(every) > MAX_LISTED else ""
    return ", ".join(every[:MAX_LISTED]) + rest


def _pieces(count: int, springs: np.ndarray) -> list[list[int]]:
    """Return the mass points of each connected piece."""
    piece = np.arange(count)
    for first, second in springs:
        piece[piece == piece[second]] = piece[first]
    return [np.flatnonzero(piece == number).tolist() for number in np.unique(piece)]
