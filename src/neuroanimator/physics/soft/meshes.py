"""Soft bodies from meshes: a cloth from triangles, a solid from tetrahedra.

Springs lie along the edges, as stiff as the material around them (Van Gelder, Approximate Simulation of Elastic
Membranes by Triangulated Spring Meshes, 1998): a finer mesh of the same cloth stretches alike.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.definitions.soft import ClothTable, SolidMusclesTable, SolidTable
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.physics.soft.mesh import Mesh, some
from neuroanimator.physics.soft.polygons import MIN_SIZE
from neuroanimator.physics.soft.soft_body import SoftBody
from neuroanimator.text import listed

MAX_FACES_OF_AN_EDGE = 2
"""Maximum number of triangles at an edge of a surface."""

Pins = Int[np.ndarray, " K"]
"""Numbers of nodes that are held."""

Sizes = Float[np.ndarray, " E"]
"""Area of each triangle [m²], or volume of each tetrahedron [m³]."""


def cloth_body(mesh: Mesh, material: ClothTable, pins: Pins, **surroundings: Any) -> SoftBody:
    """Return the cloth of a mesh of triangles; `surroundings` are `SoftBody`'s air, capsules, planes and margin.

    Raises BadFileError, which names the fault: a node without a face, or at the place of another, a face without area,
    an edge of three faces, neighbours of opposite orientation; ArgumentError for a pin that is not a node.
    """
    mesh, areas = _checked(mesh, pins)
    faces = mesh.elements
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, places = _distinct(sides)
    _check_sides(mesh, sides, places)
    stiffness = _stiffness(mesh, material.stretch, areas, edges, places)
    opposite = np.roll(faces, -2, axis=1).ravel()
    order = np.argsort(places, kind="stable")
    is_shared = places[order[1:]] == places[order[:-1]]
    folds = opposite[np.stack([order[:-1], order[1:]], axis=1)[is_shared]]
    all_stiffness = np.concatenate([stiffness, np.full(len(folds), material.bend)])
    return SoftBody(
        mesh.positions,
        _masses(mesh, material.density * areas),
        faces,
        np.concatenate([edges, folds]),
        all_stiffness,
        material.damping * all_stiffness,
        np.zeros((0, 4), int),
        np.zeros(0),
        pins,
        **surroundings,
    )


def solid_body(
    mesh: Mesh,
    material: SolidTable,
    pins: Pins,
    muscles: SolidMusclesTable | None = None,
    **surroundings: Any,
) -> SoftBody:
    """Return the solid of a mesh of tetrahedra; see `cloth_body`. Corners may be in either order, the same in all.

    Raises ArgumentError for a muscle that is no group of the mesh.
    """
    mesh, volumes = _checked(mesh, pins)
    tetrahedra = mesh.elements
    corners = np.sort(tetrahedra, axis=1)
    sides = corners[:, list(combinations(range(4), 2))].reshape(-1, 2)
    edges, places = _distinct(sides)
    stiffness = _stiffness(mesh, material.stretch, volumes, edges, places)
    return SoftBody(
        mesh.positions,
        _masses(mesh, material.density * volumes),
        _surface(mesh),
        edges,
        stiffness,
        material.damping * stiffness,
        tetrahedra,
        material.bulk / volumes,
        pins,
        muscles=_shortenings(mesh, muscles, volumes, edges, places),
        time_constant=muscles.time_constant if muscles else 0.0,
        **surroundings,
    )


def _shortenings(
    mesh: Mesh,
    muscles: SolidMusclesTable | None,
    volumes: Sizes,
    edges: Int[np.ndarray, "P 2"],
    places: Int[np.ndarray, " M"],
) -> Float[np.ndarray, "P _"]:
    """Return the share of its length by which each muscle shortens each edge, as a material does that shortens along a direction.

    An edge at an angle to it shortens by the square of the cosine; one between muscles, by their shares of the volume around.
    """
    names = list(muscles.along) if muscles else []
    shortened = np.zeros((len(edges), len(names)))
    if muscles is None:
        return shortened
    _check_groups(mesh, names)
    assert mesh.members is not None
    sides = len(places) // len(volumes)
    around = np.bincount(places, np.repeat(volumes, sides))
    extent = mesh.positions[edges[:, 1]] - mesh.positions[edges[:, 0]]
    for number, (name, direction) in enumerate(muscles.along.items()):
        inside = volumes * (mesh.members == mesh.groups.index(name))
        shares = np.bincount(places, np.repeat(inside, sides)) / around
        cosines = extent @ direction / np.linalg.norm(extent, axis=1) / np.linalg.norm(direction)
        shortened[:, number] = muscles.shorten * shares * cosines**2
    return shortened


def _check_groups(mesh: Mesh, names: list[str]) -> None:
    """Raise ArgumentError for a muscle that is no group of tetrahedra of the mesh."""
    missing = [name for name in names if name not in mesh.groups]
    if missing and not mesh.groups:
        raise ArgumentError(
            f"muscles: {mesh.name} has no named groups of tetrahedra. Name its volumes as physical groups in Gmsh: "
            'Physical Volume("left") = {1};'
        )
    if missing:
        raise ArgumentError(
            f"muscles: {mesh.name} has no tetrahedra in a group {listed(missing)}. Its groups: {listed(mesh.groups)}."
        )


def _distinct(
    sides: Int[np.ndarray, "M 2"],
) -> tuple[Int[np.ndarray, "P 2"], Int[np.ndarray, " M"]]:
    """Return (the edges in the order of their first sides, the edge of each side)."""
    edges, first, places = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    ranks = np.empty(len(order), int)
    ranks[order] = np.arange(len(order))
    return edges[order], ranks[places.reshape(-1)]


def _check_sides(mesh: Mesh, sides: Int[np.ndarray, "M 2"], places: Int[np.ndarray, " M"]) -> None:
    """Raise BadFileError for an edge of more than two faces, or of two that face opposite ways."""
    counts = np.bincount(places)
    of_many = np.flatnonzero(counts[places] > MAX_FACES_OF_AN_EDGE)
    if len(of_many):
        of_edge = np.flatnonzero(places == places[of_many[0]])
        raise BadFileError(
            f"{mesh.name}: {len(of_edge)} {mesh.named_elements(of_edge // 3)} share the edge of "
            f"{mesh.named_nodes(sides[of_edge[0]])}; wanted one or two. Remove some."
        )
    is_forward = sides[:, 0] < sides[:, 1]
    alike = np.flatnonzero((counts == 2) & (np.bincount(places, is_forward) != 1))
    if len(alike):
        pair = np.flatnonzero(places == alike[0]) // 3
        raise BadFileError(
            f"{mesh.name}: facing opposite ways: neighbouring {mesh.named_elements(pair)}. Turn one round (Blender: Mesh, "
            "Normals, Recalculate Outside)."
        )


def _surface(mesh: Mesh) -> Int[np.ndarray, "F 3"]:
    """Return the triangles of only one tetrahedron, counterclockwise from outside.

    Raises BadFileError for tetrahedra on the same side of a triangle they share.
    """
    a, b, c, d = mesh.elements.T
    sides = np.concatenate(
        [np.stack(side, axis=1) for side in ((a, c, b), (a, b, d), (b, c, d), (a, d, c))]
    )
    _, first, places, counts = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    places = places.reshape(-1)
    # seen from opposite sides, corners ascend twice in one order and once in the other
    ascents = np.bincount(places, (sides < np.roll(sides, -1, axis=1)).sum(axis=1))
    folded = np.flatnonzero((counts > 2) | ((counts == 2) & (ascents != 3)))
    if len(folded):
        pair = np.flatnonzero(places == folded[0]) % len(mesh.elements)
        raise BadFileError(
            f"{mesh.name}: on the same side of the face they share, so that they overlap: {mesh.named_elements(np.sort(pair))}. "
            "Mesh it again."
        )
    return sides[np.sort(first[counts == 1])]


def _masses(mesh: Mesh, masses: Sizes) -> Float[np.ndarray, " N"]:
    """Return the mass of each node [kg]: an equal share of each element at it."""
    corners = mesh.elements.shape[1]
    shares = np.repeat(masses / corners, corners)
    return np.bincount(mesh.elements.ravel(), shares, len(mesh.positions))


def _stiffness(
    mesh: Mesh,
    stretch: float,
    sizes: Sizes,
    edges: Int[np.ndarray, "P 2"],
    places: Int[np.ndarray, " M"],
) -> Float[np.ndarray, " P"]:
    """Return the stiffness of springs along the edges [N/m], as stiff as the elements around; `places` are their sides' edges."""
    extent = mesh.positions[edges[:, 1]] - mesh.positions[edges[:, 0]]
    around = np.bincount(places, np.repeat(sizes, len(places) // len(sizes)))
    return stretch * around / (extent**2).sum(axis=1)


def _checked(mesh: Mesh, pins: Pins) -> tuple[Mesh, Sizes]:
    """Return (the mesh, with tetrahedra in the usual order of corners, the sizes of its elements)."""
    # nodes
    count = len(mesh.positions)
    if not np.isfinite(mesh.positions).all():
        raise BadFileError(f"{mesh.name}: a node's position is not finite.")
    elements = mesh.elements
    if len(elements) == 0 or elements.min() < 0 or elements.max() >= count:
        raise BadFileError(f"{mesh.name}: wanted corners among its {count} nodes.")
    unused = np.setdiff1d(np.arange(count), elements)
    if len(unused):
        raise BadFileError(
            f"{mesh.name}: no corners of anything: {mesh.named_nodes(unused)}. Remove them."
        )
    _, first = np.unique(mesh.positions, axis=0, return_index=True)
    doubled = np.setdiff1d(np.arange(count), first)
    if len(doubled):
        raise BadFileError(
            f"{mesh.name}: at the place of others: {mesh.named_nodes(doubled)}. Merge them by distance."
        )
    # elements: none inside out, or without a size
    sizes = mesh.sizes()
    if (sizes < 0).all():
        mesh = mesh._replace(elements=elements[:, [1, 0, 2, 3]])
        sizes = -sizes
    inverted = np.flatnonzero(sizes < 0)
    if len(inverted):
        raise BadFileError(
            f"{mesh.name}: inside out, unlike others: {mesh.named_elements(inverted)}. Swap two corners of each, or mesh it "
            "again."
        )
    power = elements.shape[1] - 1
    flat = np.flatnonzero(sizes < MIN_SIZE * float(np.ptp(mesh.positions, axis=0).max()) ** power)
    if len(flat):
        size = "area" if power == 2 else "volume"
        raise BadFileError(
            f"{mesh.name}: without {size}: {mesh.named_elements(flat)}. Remove them."
        )
    # pins
    wrong = pins[(pins < 0) | (pins >= count)]
    if len(wrong):
        raise ArgumentError(f"pins: {some(wrong)} are not nodes; the mesh has 0 to {count - 1}.")
    return mesh, sizes
