"""Left and right of a deformable body: the partners in its definition, and a check that they are mirror images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Int

from neuroanimator.definitions.body import BodyDefinition, control_names
from neuroanimator.errors import ArgumentError
from neuroanimator.physics.deformable.body import Body
from neuroanimator.state.structure import REVERSE_Y, Mirror
from neuroanimator.text import listed

TOLERANCE = 1e-9
"""Relative tolerance of differences between left and right, for rounding."""

Numbers = dict[str, list[float]]
"""Numbers of each part of a body, by its name."""


def mirror_of(definition: BodyDefinition, body: Body) -> Mirror | None:
    """Return left and right of `body`; None if the definition names no partners.

    Raises ArgumentError if a partner is missing, or if reversing Y does not give the same body.
    """
    if not definition.mirror:
        return None
    partners = _partners(definition)
    nodes = _partner_numbers(definition, "nodes", partners)
    controls = _partner_numbers(definition, "controls", partners)
    _check_mirror(body, nodes, controls, control_names(definition))
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


def _check_mirror(
    body: Body,
    nodes: Int[np.ndarray, " N"],
    controls: Int[np.ndarray, " C"],
    control_names: Sequence[str],
) -> None:
    """Refuse a mirror that is not one: reversing Y must give the same body under the same controls.

    `nodes` and `controls` are the partners of each.
    """
    mass_points: Numbers = {}
    mass_point_images: Numbers = {}
    for i, name in enumerate(body.names):
        mass_points[name] = [*body.positions[i], body.masses[i]]
        image = body.positions[i] * REVERSE_Y + 0.0  # no negative zero
        mass_point_images[body.names[int(nodes[i])]] = [*image, body.masses[i]]
    _refuse_difference("node", "position [m] and mass [kg]", mass_points, mass_point_images)
    springs: Numbers = {}
    spring_images: Numbers = {}
    partner_muscles = controls[: body.muscles.shape[1]]
    for number, ends in enumerate(body.springs):
        material = [body.stiffness[number], body.damping[number]]
        springs[_pair(body, ends)] = [*material, *body.muscles[number]]
        image = body.muscles[number, partner_muscles]
        spring_images[_pair(body, nodes[ends])] = [*material, *image]
    meaning = "stiffness [N/m], damping [N·s/m] and share by which each muscle shortens it"
    _refuse_difference("spring", meaning, springs, spring_images)
    faces = Counter(_ring(body, face) for face in body.faces)
    face_images = Counter(_ring(body, nodes[face][::-1]) for face in body.faces)
    for ring in face_images - faces:
        raise ArgumentError(
            f"mirror: a face is missing: {list(ring)}, the mirror image of one that exists. "
            "Add it, or leave out the mirror."
        )
    forces: Numbers = {}
    force_images: Numbers = {}
    for number, force in enumerate(body.external_forces.T):
        forces[control_names[number]] = [*force]
        force_images[control_names[int(controls[number])]] = [*(force * REVERSE_Y + 0.0)]
    _refuse_difference("external force", "force [N]", forces, force_images)


def _refuse_difference(noun: str, meaning: str, parts: Numbers, images: Numbers) -> None:
    """Refuse a body whose parts have other numbers than those of its mirror image, or that lacks one of them."""
    if not parts:
        return
    scale = np.abs(np.array(list(parts.values()))).max(axis=0)
    for name, wanted in images.items():
        given = parts.get(name)
        if given is None or not np.allclose(given, wanted, TOLERANCE, TOLERANCE * scale):
            shown = "none" if given is None else _shown(given)
            raise ArgumentError(
                f"mirror: {noun} {name}: as the image of its partner it needs {_shown(wanted)}, got {shown} ({meaning}). "
                "Make both the same, name another partner, or leave out the mirror."
            )


def _shown(numbers: list[float]) -> list[float]:
    return np.array(numbers).tolist()


def _pair(body: Body, ends: Int[np.ndarray, " 2"]) -> str:
    first, second = sorted(body.names[i] for i in ends)
    return f"{first} to {second}"


def _ring(body: Body, corners: Int[np.ndarray, " 4"]) -> tuple[str, ...]:
    """Return the names of the corners, in the same sense, starting with the alphabetically first."""
    ring = list(dict.fromkeys(body.names[i] for i in corners))
    first = ring.index(min(ring))
    return tuple(ring[first:] + ring[:first])
