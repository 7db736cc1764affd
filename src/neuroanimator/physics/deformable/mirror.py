"""Left and right of a deformable body: the partners in its definition, and a check that they are mirror images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.definitions.body import BodyDefinition, control_names
from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known
from neuroanimator.physics.deformable.body import Body
from neuroanimator.state.structure import REVERSE_Y, Mirror

TOLERANCE = 1e-9
"""Relative tolerance of differences between left and right, for rounding."""


def mirror_of(definition: BodyDefinition, body: Body) -> Mirror | None:
    """Return left and right of `body`; None if the definition names no partners.

    Raises ArgumentError if a partner is missing, or if reversing Y does not give the same body.
    """
    if not definition.mirror:
        return None
    names = control_names(definition)
    partners = _partners(definition.mirror, (*body.names, *names))
    nodes = _partner_numbers(body.names, partners)
    controls = _partner_numbers(names, partners)
    _check_mirror(body, nodes, controls, names)
    return Mirror(tuple(nodes.tolist()), tuple(controls.tolist()))


def _partners(mirror: Mapping[str, str], known: Sequence[str]) -> dict[str, str]:
    """Return each name's partner, both ways; ArgumentError for an unknown name and for one with two partners."""
    check_known((*mirror, *mirror.values()), known, "node or control", "mirror")
    partners = dict(mirror)
    for partner, name in mirror.items():
        if partners.setdefault(name, partner) != partner:
            raise ArgumentError(
                f"mirror: '{name}' has two partners, '{partners[name]}' and '{partner}'. Name one."
            )
    return partners


def _partner_numbers(names: Sequence[str], partners: Mapping[str, str]) -> Int[np.ndarray, " K"]:
    """Return the partner of each node, or of each control; one without a partner is its own."""
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
    # mass points
    points = np.column_stack([body.positions, body.masses])
    images = points * np.append(REVERSE_Y, 1.0)
    names = [body.names[node] for node in nodes.tolist()]
    _refuse_difference("node", "position [m] and mass [kg]", names, points[nodes], images)
    # springs, and the muscles that shorten them
    number_of = {frozenset(ends): number for number, ends in enumerate(body.springs.tolist())}
    reflected = nodes[body.springs].tolist()
    partners = np.array([number_of.get(frozenset(ends), -1) for ends in reflected])
    partner_muscles = controls[: body.muscles.shape[1]]
    springs = np.column_stack([body.stiffness, body.damping, body.muscles])[partners]
    springs[partners < 0] = np.nan
    images = np.column_stack([body.stiffness, body.damping, body.muscles[:, partner_muscles]])
    names = [" to ".join(sorted(body.names[node] for node in ends)) for ends in reflected]
    meaning = "stiffness [N/m], damping [N·s/m] and share by which each muscle shortens it"
    _refuse_difference("spring", meaning, names, springs, images)
    # faces
    faces = Counter(_ring(body, face) for face in body.faces)
    face_images = Counter(_ring(body, nodes[face][::-1]) for face in body.faces)
    for ring in face_images - faces:
        raise ArgumentError(
            f"mirror: a face is missing: {list(ring)}, the mirror image of one that exists. "
            "Add it, or leave out the mirror."
        )
    # external forces
    forces = body.external_forces.T
    names = [control_names[int(control)] for control in controls]
    _refuse_difference("external force", "force [N]", names, forces[controls], forces * REVERSE_Y)


def _refuse_difference(
    noun: str,
    meaning: str,
    names: Sequence[str],
    parts: Float[np.ndarray, "K V"],
    images: Float[np.ndarray, "K V"],
) -> None:
    """Refuse a body whose parts of these `names` have other numbers than the images of their partners; NaN if one is missing."""
    scale = np.abs(images).max(axis=0, initial=0.0)
    is_alike = np.isclose(parts, images, TOLERANCE, TOLERANCE * scale).all(axis=1)
    for row in np.flatnonzero(~is_alike).tolist():
        shown = "none" if np.isnan(parts[row]).any() else parts[row].tolist()
        wanted = (images[row] + 0.0).tolist()  # no negative zero
        raise ArgumentError(
            f"mirror: {noun} {names[row]}: as the image of its partner it needs {wanted}, got {shown} ({meaning}). "
            "Make both the same, name another partner, or leave out the mirror."
        )


def _ring(body: Body, corners: Int[np.ndarray, " 4"]) -> tuple[str, ...]:
    """Return the names of the corners, in the same sense, starting with the alphabetically first."""
    ring = list(dict.fromkeys(body.names[i] for i in corners))
    first = ring.index(min(ring))
    return tuple(ring[first:] + ring[:first])
