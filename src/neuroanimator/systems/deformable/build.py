"""From a written-down body to its arrays: mass points, springs, muscles, faces, mirror, gait."""

from __future__ import annotations

import numpy as np

from neuroanimator.definitions.body import MAX_NODES, MAX_SPRINGS, BodyDefinition, control_names
from neuroanimator.errors import ArgumentError
from neuroanimator.state.gait import Gait
from neuroanimator.systems.deformable.body import Body, Ground, Water
from neuroanimator.systems.deformable.checks import (
    check_faces,
    check_muscles,
    check_nodes,
    check_springs,
    listed,
)


def body_of(definition: BodyDefinition) -> Body:
    """Return the body `definition` describes; ArgumentError names what is wrong with it."""
    check_nodes(definition, MAX_NODES)
    names = tuple(definition.nodes)
    numbers = np.array(list(definition.nodes.values()), float)
    rows = [(pair, table) for table in definition.springs.values() for pair in table.pairs]
    springs = np.array([_numbers(names, pair, "springs") for pair, _ in rows])
    check_springs(names, numbers[:, :3], springs, MAX_SPRINGS)
    muscles, external_forces = _drives(definition, springs, names)
    check_muscles(names, springs, muscles)
    faces = np.array([_corners(names, face) for face in definition.faces], int).reshape(-1, 4)
    check_faces(definition.faces, numbers[:, :3], faces)
    return Body(
        names=names,
        positions=numbers[:, :3],
        masses=numbers[:, 3],
        springs=springs,
        stiffness=np.array([table.stiffness for _, table in rows]),
        damping=np.array([table.damping for _, table in rows]),
        muscles=muscles,
        external_forces=external_forces,
        faces=faces,
        time_constant=definition.muscles.time_constant if definition.muscles else 0.0,
        water=Water(**definition.water.model_dump()) if definition.water else None,
        ground=Ground(**definition.ground.model_dump()) if definition.ground else None,
        rest_height=definition.rest_height,
    )


def group_numbers(definition: BodyDefinition) -> dict[str, tuple[int, ...]]:
    """Return the groups as numbers of mass points; refuse groups that miss or repeat one."""
    names = list(definition.nodes)
    seen: dict[str, str] = {}
    for group, members in definition.groups.items():
        for member in members:
            if member not in names:
                raise ArgumentError(
                    f"groups.{group}: no node called '{member}'. Nodes: {listed(names)}."
                )
            if member in seen:
                raise ArgumentError(
                    f"groups.{group}: node '{member}' is in '{seen[member]}' already. Leave it in one."
                )
            seen[member] = group
    missing = [name for name in names if name not in seen]
    if definition.groups and missing:
        raise ArgumentError(
            f"groups: in none of them: {listed(missing)}. Put each into exactly one."
        )
    return {
        group: tuple(names.index(m) for m in members)
        for group, members in definition.groups.items()
    }


def mirror_of(definition: BodyDefinition, kind: str) -> np.ndarray | None:
    """Return (K,) each node's or control's partner; None where the body has no mirror.

    `body_checks.check_mirror` says whether it is one.
    """
    if not definition.mirror:
        return None
    every = {"nodes": list(definition.nodes), "controls": control_names(definition)}
    both = dict(definition.mirror)
    for left, right in definition.mirror.items():
        for name, partner in ((left, right), (right, left)):
            if name not in every["nodes"] + every["controls"]:
                raise ArgumentError(
                    f"mirror: no node or control called '{name}'. Nodes: {listed(every['nodes'])}."
                )
            if both.setdefault(name, partner) != partner:
                raise ArgumentError(
                    f"mirror: '{name}' has two partners, '{both[name]}' and '{partner}'. Name one."
                )
    for name in every[kind]:
        if both.get(name, name) not in every[kind]:
            raise ArgumentError(
                f"mirror: '{name}' has a partner of another kind, '{both[name]}'. Pair a node with a node, a control "
                "with a control."
            )
    return np.array([every[kind].index(both.get(name, name)) for name in every[kind]])


def gait_of(definition: BodyDefinition) -> Gait | None:
    """Return the gait; ArgumentError if it drives a control that is not there."""
    table, names = definition.gait, control_names(definition)
    if table is None:
        return None
    for name in table.controls:
        if name not in names:
            raise ArgumentError(
                f"gait.controls: no control called '{name}'. Controls: {', '.join(names)}."
            )
    amplitudes, lags = zip(*(table.controls.get(name, (0.0, 0.0)) for name in names), strict=True)
    return Gait(table.period, amplitudes, lags)


def _numbers(names: tuple[str, ...], members: tuple[str, ...], key: str) -> list[int]:
    for member in members:
        if member not in names:
            raise ArgumentError(
                f"{key}: {list(members)}: no node called '{member}'. Nodes: {listed(names)}."
            )
    return [names.index(member) for member in members]


def _corners(names: tuple[str, ...], face: tuple[str, ...]) -> list[int]:
    corners = _numbers(names, face, "faces")
    return corners if len(corners) == 4 else [*corners, corners[0]]


def _drives(
    definition: BodyDefinition, springs: np.ndarray, names: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares by which contractions shorten springs (P, M), and pushes (3, C)."""
    table = definition.muscles
    if bool(table) == bool(definition.external_forces):
        came = "both" if table else "neither"
        raise ArgumentError(
            f"muscles or external_forces: wanted exactly one of the two tables to drive the body, came {came}. "
            f"{'Leave one out' if table else 'Add one'}."
        )
    if not table:
        return np.zeros((len(springs), 0)), np.array(
            list(definition.external_forces.values()), float
        ).T
    shorten = np.zeros((len(springs), len(table.springs)))
    spring_of = {frozenset(pair): number for number, pair in enumerate(springs.tolist())}
    for column, (name, pairs) in enumerate(table.springs.items()):
        if not pairs:
            raise ArgumentError(
                f"muscles.springs.{name}: wanted at least one spring, came none. Name some."
            )
        for pair in pairs:
            wanted = frozenset(_numbers(names, pair, f"muscles.springs.{name}"))
            if wanted not in spring_of:
                raise ArgumentError(
                    f"muscles.springs.{name}: no spring connects {list(pair)}. Add it under 'springs', or name another."
                )
            shorten[spring_of[wanted], column] = table.shorten
    return shorten, np.zeros((3, shorten.shape[1]))
