"""Left and right of a deformable body: partners as its definition pairs them, and whether they are mirror images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Int
from numpy.typing import ArrayLike

from neuroanimator.definitions.body import BodyDefinition, control_names
from neuroanimator.errors import ArgumentError
from neuroanimator.state.structure import Mirror
from neuroanimator.systems.deformable.body import Body
from neuroanimator.text import listed

TOLERANCE = 1e-9
"""Relative tolerance within which left and right are the same: rounding."""

REVERSE_Y = np.array([1.0, -1.0, 1.0])
"""Factors by which the mirror multiplies a vector, axis by axis."""


def mirror_of(definition: BodyDefinition, body: Body) -> Mirror | None:
    """Return left and right of `body`; None where the definition names no partners.

    Raises ArgumentError where a partner is missing, or where reversing Y does not give the same body.
    """
    if not definition.mirror:
        return None
    partners = _partners(definition)
    nodes = _partner_numbers(definition, "nodes", partners)
    controls = _partner_numbers(definition, "controls", partners)
    check_mirror(body, nodes, controls, control_names(definition))
    return Mirror(tuple(nodes.tolist()), tuple(controls.tolist()))


def _partners(definition: BodyDefinition) -> dict[str, str]:
    """Return each name's partner, both ways; ArgumentError for an unknown name and for one with two partners."""
    nodes = list(definition.nodes)
    known = nodes + control_names(definition)
    partners = dict(definition.mirror)
    for left, right in definition.mirror.items():
        for name, partner in ((left, right), (right, left)):
            if name not in known:
                raise ArgumentError(
                    f"mirror: no node or control called '{name}'. Nodes: {listed(nodes)}."
                )
            if partners.setdefault(name, partner) != partner:
                raise ArgumentError(
                    f"mirror: '{name}' has two partners, '{partners[name]}' and '{partner}'. Name one."
                )
    return partners


def _partner_numbers(
    definition: BodyDefinition, kind: Literal["nodes", "controls"], partners: dict[str, str]
) -> Int[np.ndarray, " K"]:
    """Return each node's or control's partner; a name without one is its own."""
    names = list(definition.nodes) if kind == "nodes" else control_names(definition)
    numbers = []
    for name in names:
        partner = partners.get(name, name)
        if partner not in names:
            raise ArgumentError(
                f"mirror: '{name}' has a partner of another kind, '{partner}'. Pair a node with a node, a control "
                "with a control."
            )
        numbers.append(names.index(partner))
    return np.array(numbers, int)


def check_mirror(
    body: Body,
    nodes: Int[np.ndarray, " N"],
    controls: Int[np.ndarray, " C"],
    control_names: Sequence[str],
) -> None:
    """Refuse a mirror that is not one: reversing Y must give the same body under the same controls.

    `nodes` and `controls` are the partners of each.
    """
    _check_nodes(body, nodes)
    _check_springs(body, nodes, controls, control_names)
    _check_faces(body, nodes)
    _check_external_forces(body, controls, control_names)


def _check_nodes(body: Body, nodes: Int[np.ndarray, " N"]) -> None:
    mirrored = body.positions * REVERSE_Y
    partners = body.positions[nodes]
    distances = np.abs(partners - mirrored).max(axis=1)
    size = np.ptp(body.positions, axis=0).max()
    i = _first_true(distances > TOLERANCE * size)
    if i is not None:
        wanted = (mirrored[i] + 0.0).tolist()  # no minus before a zero
        came = (partners[i] + 0.0).tolist()
        raise ArgumentError(
            f"mirror: '{body.names[i]}' needs a partner at {wanted}, but '{body.names[int(nodes[i])]}' is at {came}. "
            "Move one, or name the other."
        )
    i = _first_true(~_is_close(body.masses[nodes], body.masses))
    if i is not None:
        raise ArgumentError(
            f"mirror: '{body.names[i]}' has {body.masses[i]:g} kg and its partner '{body.names[int(nodes[i])]}' "
            f"{body.masses[nodes[i]]:g} kg. Give both the same mass."
        )


def _check_springs(
    body: Body,
    nodes: Int[np.ndarray, " N"],
    controls: Int[np.ndarray, " C"],
    control_names: Sequence[str],
) -> None:
    springs = body.springs.tolist()
    number_of = {frozenset(ends): number for number, ends in enumerate(springs)}
    muscle_partners = controls[: body.muscles.shape[1]]
    for spring, ends in enumerate(springs):
        partner_ends = nodes[ends].tolist()
        pair = [body.names[i] for i in ends]
        partner_pair = [body.names[i] for i in partner_ends]
        partner = number_of.get(frozenset(partner_ends))
        if partner is None:
            raise ArgumentError(
                f"mirror: spring {pair} has no partner {partner_pair}. Add it, or leave out the mirror."
            )
        for what, values in (("stiffness", body.stiffness), ("damping", body.damping)):
            if not _is_close(values[spring], values[partner]):
                raise ArgumentError(
                    f"mirror: spring {pair} has {what} {values[spring]:g} and its partner {partner_pair} "
                    f"{values[partner]:g}. Make them the same."
                )
        c = _first_true(body.muscles[partner, muscle_partners] != body.muscles[spring])
        if c is not None:
            raise ArgumentError(
                f"mirror: muscle '{control_names[c]}' shortens {pair} by {body.muscles[spring, c]:g}, but its partner "
                f"'{control_names[int(controls[c])]}' shortens {partner_pair} by "
                f"{body.muscles[partner, controls[c]]:g}. Name the other partner, or the mirrored springs."
            )


def _check_faces(body: Body, nodes: Int[np.ndarray, " N"]) -> None:
    present = Counter(_ring(face) for face in body.faces.tolist())
    mirrored = Counter(_ring(nodes[face][::-1].tolist()) for face in body.faces)
    for ring in mirrored - present:
        corners = [body.names[i] for i in ring]
        raise ArgumentError(
            f"mirror: a face is missing: {corners}, the mirror image of one that is there. "
            "Add it, or leave out the mirror."
        )


def _ring(corners: Sequence[int]) -> tuple[int, ...]:
    """Return the corners from the smallest one on, in the same sense."""
    ring = list(dict.fromkeys(corners))
    first = ring.index(min(ring))
    return tuple(ring[first:] + ring[:first])


def _check_external_forces(
    body: Body, controls: Int[np.ndarray, " C"], control_names: Sequence[str]
) -> None:
    forces = body.external_forces
    difference = np.abs(forces[:, controls] - forces * REVERSE_Y[:, None]).max(axis=0)
    c = _first_true(difference > TOLERANCE * np.abs(forces).max(initial=0))
    if c is not None:
        raise ArgumentError(
            f"mirror: reversing Y, the external force '{control_names[c]}' does not become that of "
            f"'{control_names[int(controls[c])]}'. Make them mirror images, or leave out the mirror."
        )


def _is_close(left: ArrayLike, right: ArrayLike) -> Any:
    return np.isclose(left, right, rtol=TOLERANCE, atol=0)


def _first_true(flags: Bool[np.ndarray, " K"]) -> int | None:
    """Return the number of the first flag that is set; None if none is."""
    numbers = np.flatnonzero(flags)
    if not len(numbers):
        return None
    return int(numbers[0])
