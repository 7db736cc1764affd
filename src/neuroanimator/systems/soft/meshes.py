"""Soft bodies from meshes: a cloth from triangles, a solid from tetrahedra.

Springs lie along the edges, as stiff as the material around them (Van Gelder, Approximate Simulation of Elastic
Membranes by Triangulated Spring Meshes, 1998): a finer mesh of the same cloth stretches alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.systems.soft.mesh import Mesh, some
from neuroanimator.systems.soft.polygons import MIN_SIZE
from neuroanimator.systems.soft.soft_body import SoftBody

MAX_FACES_OF_AN_EDGE = 2
"""Maximum number of triangles at an edge of a surface."""


@dataclass(frozen=True)
class Cloth:
    """The material of a surface."""

    density: float = 0.2
    """Density [kg/m²]."""
    stretch: float = 100.0
    """Young's modulus times thickness [N/m]."""
    bend: float = 1.0
    """Stiffness of the springs across folds [N/m], which resist sharp folds, but hardly slight ones."""
    damping: float = 2e-3
    """Time constant of internal friction [s]: damping of a spring over its stiffness."""


@dataclass(frozen=True)
class Solid:
    """The material of a body of tetrahedra."""

    density: float = 1000.0
    """Density [kg/m³]."""
    stretch: float = 2e4
    """Young's modulus [Pa]."""
    bulk: float = 2e5
    """Bulk modulus [Pa]."""
    damping: float = 2e-3
    """Time constant of internal friction [s]: damping of a spring over its stiffness."""


def cloth_body(
    mesh: Mesh, material: Cloth, pins: Int[np.ndarray, " K"], **surroundings: Any
) -> SoftBody:
    """Return the cloth of a mesh of triangles; `surroundings` are `SoftBody`'s air, capsules, planes and margin.

    Raises BadFileError, which names the fault: a node without a face, or at the place of another, a face without area,
    an edge of three faces, neighbours of opposite orientation; ArgumentError for a pin that is not a node.
    """
    _check_nodes(mesh)
    areas = mesh.sizes()
    _check_sizes(mesh, areas, 2, "area")
    _check_pins(pins, len(mesh.positions))
    faces = mesh.elements
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, places = _distinct(sides)
    _check_sides(mesh, sides, places)
    around = np.bincount(places, np.repeat(areas, 3))
    stiffness = material.stretch * around / _squared_lengths(mesh.positions, edges)
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
    mesh: Mesh, material: Solid, pins: Int[np.ndarray, " K"], **surroundings: Any
) -> SoftBody:
    """Return the solid of a mesh of tetrahedra; see `cloth_body`. Corners may be in either order, the same in all."""
    _check_nodes(mesh)
    volumes = mesh.sizes()
    if (volumes < 0).all():
        mesh = mesh._replace(elements=mesh.elements[:, [1, 0, 2, 3]])
        volumes = -volumes
    inverted = np.flatnonzero(volumes < 0)
    if len(inverted):
        raise BadFileError(
            f"{mesh.name}: inside out, unlike others: {mesh.named_elements(inverted)}. Swap two corners of each, or mesh it "
            "again."
        )
    _check_sizes(mesh, volumes, 3, "volume")
    _check_pins(pins, len(mesh.positions))
    tetrahedra = mesh.elements
    corners = np.sort(tetrahedra, axis=1)
    sides = corners[:, list(combinations(range(4), 2))].reshape(-1, 2)
    edges, places = _distinct(sides)
    around = np.bincount(places, np.repeat(volumes, 6))
    stiffness = material.stretch * around / _squared_lengths(mesh.positions, edges)
    return SoftBody(
        mesh.positions,
        _masses(mesh, material.density * volumes),
        _surface(tetrahedra),
        edges,
        stiffness,
        material.damping * stiffness,
        tetrahedra,
        material.bulk / volumes,
        pins,
        **surroundings,
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


def _surface(tetrahedra: Int[np.ndarray, "T 4"]) -> Int[np.ndarray, "F 3"]:
    """Return the triangles of only one tetrahedron, counterclockwise from outside."""
    a, b, c, d = tetrahedra.T
    sides = np.concatenate(
        [np.stack(side, axis=1) for side in ((a, c, b), (a, b, d), (b, c, d), (a, d, c))]
    )
    _, places, counts = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True
    )
    return sides[np.sort(places[counts == 1])]


def _masses(mesh: Mesh, masses: Float[np.ndarray, " E"]) -> Float[np.ndarray, " N"]:
    """Return the mass of each node [kg]: an equal share of each element at it."""
    corners = mesh.elements.shape[1]
    shares = np.repeat(masses / corners, corners)
    return np.bincount(mesh.elements.ravel(), shares, len(mesh.positions))


def _squared_lengths(
    positions: Float[np.ndarray, "N 3"], edges: Int[np.ndarray, "P 2"]
) -> Float[np.ndarray, " P"]:
    extent = positions[edges[:, 1]] - positions[edges[:, 0]]
    return (extent**2).sum(axis=1)


def _check_nodes(mesh: Mesh) -> None:
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


def _check_sizes(mesh: Mesh, sizes: Float[np.ndarray, " E"], power: int, size: str) -> None:
    extent = float(np.ptp(mesh.positions, axis=0).max())
    flat = np.flatnonzero(sizes < MIN_SIZE * extent**power)
    if len(flat):
        raise BadFileError(
            f"{mesh.name}: without {size}: {mesh.named_elements(flat)}. Remove them."
        )


def _check_pins(pins: Int[np.ndarray, " K"], count: int) -> None:
    wrong = pins[(pins < 0) | (pins >= count)]
    if len(wrong):
        raise ArgumentError(f"pins: {some(wrong)} are not nodes; the mesh has 0 to {count - 1}.")
