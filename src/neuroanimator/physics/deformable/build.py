"""From the definition of a body to its arrays: mass points, springs, muscles, external forces, faces, groups, gait."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.definitions.body import (
    MAX_NODES,
    MAX_SPRINGS,
    BodyDefinition,
    MuscleTable,
)
from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known
from neuroanimator.physics.deformable.body import Body, Ground, area_vectors
from neuroanimator.physics.deformable.checks import check_muscles, check_nodes, check_springs
from neuroanimator.physics.groups import check_groups
from neuroanimator.physics.water import Water
from neuroanimator.text import listed

FACE_CORNERS = 4
"""Number of corners in an array of faces; a triangle repeats its first one."""

MIN_FACE_AREA = 1e-12
"""Minimum area of a face [m²]: a smaller one has no normal."""


def body_of(definition: BodyDefinition) -> Body:
    """Return the body `definition` describes; ArgumentError names the fault."""
    check_nodes(definition, MAX_NODES)
    names = tuple(definition.nodes)
    nodes = np.array(list(definition.nodes.values()), float)
    positions = nodes[:, :3]
    springs, stiffness, damping, groups = _springs(definition, names)
    check_springs(names, positions, springs, MAX_SPRINGS)
    _check_drive(definition)
    muscles = _muscles(definition.muscles, springs, names)
    check_muscles(names, springs, muscles)
    faces = [_corners(names, face) for face in definition.faces]
    corners = np.array(faces, int).reshape(-1, FACE_CORNERS)
    check_faces(definition.faces, positions, corners)
    water, ground = definition.water, definition.ground
    return Body(
        names=names,
        positions=positions,
        masses=nodes[:, 3],
        springs=springs,
        stiffness=stiffness,
        damping=damping,
        muscles=muscles,
        external_forces=_external_forces(definition),
        faces=corners,
        time_constant=definition.muscles.time_constant if definition.muscles else 0.0,
        water=Water(**water.model_dump()) if water else None,
        ground=Ground(**ground.model_dump()) if ground else None,
        rest_height=definition.rest_height,
        spring_groups=groups,
        varied=tuple(table.sets for table in definition.parameters.values()),
    )


def group_numbers(definition: BodyDefinition) -> dict[str, tuple[int, ...]]:
    """Return the groups as numbers of mass points; refuse groups that miss or repeat one."""
    names = list(definition.nodes)
    check_groups(definition.groups, names, "node")
    grouped = {member for members in definition.groups.values() for member in members}
    missing = [name for name in names if name not in grouped]
    if definition.groups and missing:
        raise ArgumentError(
            f"groups: {listed(missing)} belong to no group. Put each into exactly one."
        )
    return {
        group: tuple(names.index(member) for member in members)
        for group, members in definition.groups.items()
    }


def _springs(
    definition: BodyDefinition, names: tuple[str, ...]
) -> tuple[
    Int[np.ndarray, "P 2"], Float[np.ndarray, " P"], Float[np.ndarray, " P"], tuple[str, ...]
]:
    """Return the springs' ends, their stiffness [N/m], their damping [N·s/m] and the names of their groups."""
    ends = []
    stiffness = []
    damping = []
    groups = []
    for group, table in definition.springs.items():
        for pair in table.pairs:
            ends.append(_node_numbers(names, pair, "springs"))
            stiffness.append(table.stiffness)
            damping.append(table.damping)
            groups.append(group)
    return np.array(ends), np.array(stiffness), np.array(damping), tuple(groups)


def _node_numbers(names: tuple[str, ...], members: Sequence[str], key: str) -> list[int]:
    check_known(members, names, "node", f"{key}: {list(members)}")
    return [names.index(member) for member in members]


def _corners(names: tuple[str, ...], face: tuple[str, ...]) -> list[int]:
    corners = _node_numbers(names, face, "faces")
    if len(corners) < FACE_CORNERS:
        return [*corners, corners[0]]
    return corners


def _check_drive(definition: BodyDefinition) -> None:
    if bool(definition.muscles) != bool(definition.external_forces):
        return
    given, remedy = ("both", "Leave one out") if definition.muscles else ("neither", "Add one")
    raise ArgumentError(
        "muscles or external_forces: wanted exactly one of the two tables to drive the body, "
        f"got {given}. {remedy}."
    )


def _external_forces(definition: BodyDefinition) -> Float[np.ndarray, "3 C"]:
    """Return the force on the whole body per control [N]: zeros for a body with muscles."""
    if definition.muscles:
        return np.zeros((3, len(definition.muscles.springs)))
    return np.array(list(definition.external_forces.values()), float).T


def _muscles(
    table: MuscleTable | None, springs: Int[np.ndarray, "P 2"], names: tuple[str, ...]
) -> Float[np.ndarray, "P M"]:
    """Return the share of its length by which each muscle shortens each spring."""
    if table is None:
        return np.zeros((len(springs), 0))
    muscles = np.zeros((len(springs), len(table.springs)))
    spring_of = {frozenset(ends): number for number, ends in enumerate(springs.tolist())}
    for column, (name, pairs) in enumerate(table.springs.items()):
        if not pairs:
            raise ArgumentError(
                f"muscles.springs.{name}: wanted at least one spring, got none. Name some."
            )
        for pair in pairs:
            ends = frozenset(_node_numbers(names, pair, f"muscles.springs.{name}"))
            if ends not in spring_of:
                raise ArgumentError(
                    f"muscles.springs.{name}: no spring connects {list(pair)}. Add it under 'springs', or name another."
                )
            muscles[spring_of[ends], column] = table.shorten
    return muscles


def check_faces(
    faces: Sequence[Sequence[str]],
    positions: Float[np.ndarray, "N 3"],
    corners: Int[np.ndarray, "F 4"],
) -> None:
    """Refuse faces without area, neighbours that face opposite sides, and a skin that faces inward.

    A two-sided face is a fin's and may face anywhere. `faces` are the corners by name, for the message; `corners` the
    same as numbers of mass points.
    """
    areas = area_vectors(positions, corners)
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
    arms = positions[corners[single]].mean(axis=1) - positions.mean(axis=0)
    if np.sum(areas[single] * arms) < 0:
        raise ArgumentError(
            f"faces: {list(faces[single[0]])} looks inward. List its corners counterclockwise from outside."
        )
