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

from neuroanimator.appearance.shapes import MAX_NODES
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.systems.soft.soft_body import SoftBody, tetrahedron_volumes

MAX_FACES_OF_AN_EDGE = 2
"""Maximum number of triangles at an edge of a surface."""

LEAST_SIZE = 1e-9
"""Minimum area or volume of an element, over the square or cube of the mesh's size."""

BYTES_A_NODE = 60_000
"""Memory for finding the shapes of a body [bytes per node]: snapshots of sixteen bodies."""

SHOWN = 3
"""Maximum number of nodes or elements a message names."""


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


def refuse_size(name: str, count: int) -> None:
    """Raise BadFileError for a mesh of more than `MAX_NODES` nodes."""
    if count > MAX_NODES:
        gigabytes = count * BYTES_A_NODE / 1e9
        raise BadFileError(
            f"{name}: {count:,} nodes, for which {gigabytes:,.0f} GB would be needed; wanted at most {MAX_NODES:,}. "
            "Make the mesh coarser."
        )


def cloth_body(
    positions: Float[np.ndarray, "N 3"],
    faces: Int[np.ndarray, "F 3"],
    material: Cloth,
    pins: Int[np.ndarray, " K"],
    **surroundings: Any,
) -> SoftBody:
    """Return the cloth of these `faces`; `surroundings` are `SoftBody`'s air, capsules, planes and margin.

    Raises ArgumentError, which names the fault: a node without a face, or at the place of another, a face without area,
    an edge of three faces, neighbours of opposite orientation, a pin that is not a node.
    """
    _check_nodes(positions, faces, "face")
    areas = _areas(positions, faces)
    _check_sizes(areas, positions, 2, "face", "area")
    sides = _sides(faces)
    _check_pins(pins, len(positions))
    edges = np.array(list(sides))
    around = np.array([areas[[face for face, _ in beside]].sum() for beside in sides.values()])
    stiffness = material.stretch * around / _squared_lengths(positions, edges)
    across = [[beside[0][1], beside[1][1]] for beside in sides.values() if len(beside) > 1]
    folds = np.array(across, int).reshape(-1, 2)
    all_stiffness = np.concatenate([stiffness, np.full(len(folds), material.bend)])
    return SoftBody(
        positions,
        _masses(len(positions), faces, material.density * areas),
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
    positions: Float[np.ndarray, "N 3"],
    tetrahedra: Int[np.ndarray, "T 4"],
    material: Solid,
    pins: Int[np.ndarray, " K"],
    **surroundings: Any,
) -> SoftBody:
    """Return the solid of these `tetrahedra`; see `cloth_body`. Inverted tetrahedra are refused, too."""
    _check_nodes(positions, tetrahedra, "tetrahedron")
    volumes = tetrahedron_volumes(positions, tetrahedra)
    inverted = np.flatnonzero(volumes < 0)
    if len(inverted):
        raise ArgumentError(
            f"mesh: tetrahedra {some(inverted)} are inside out. Swap two corners of each."
        )
    _check_sizes(volumes, positions, 3, "tetrahedron", "volume")
    _check_pins(pins, len(positions))
    around: dict[tuple[int, int], float] = {}
    for corners, volume in zip(np.sort(tetrahedra, axis=1).tolist(), volumes, strict=True):
        for edge in combinations(corners, 2):
            around[edge] = around.get(edge, 0.0) + volume
    edges = np.array(list(around))
    stiffness = (
        material.stretch * np.array(list(around.values())) / _squared_lengths(positions, edges)
    )
    return SoftBody(
        positions,
        _masses(len(positions), tetrahedra, material.density * volumes),
        _surface(tetrahedra),
        edges,
        stiffness,
        material.damping * stiffness,
        tetrahedra,
        material.bulk / volumes,
        pins,
        **surroundings,
    )


def _areas(
    positions: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, " F"]:
    corners = positions[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(normals, axis=1) / 2


def _sides(faces: Int[np.ndarray, "F 3"]) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """Return the faces at each edge, each with its corner that is not on the edge."""
    sides: dict[tuple[int, int], list[tuple[int, int]]] = {}
    directed: set[tuple[int, int]] = set()
    for face, (a, b, c) in enumerate(faces.tolist()):
        for first, second, opposite in ((a, b, c), (b, c, a), (c, a, b)):
            beside = sides.setdefault((min(first, second), max(first, second)), [])
            beside.append((face, opposite))
            if len(beside) > MAX_FACES_OF_AN_EDGE:
                raise ArgumentError(
                    f"mesh: {len(beside)} faces share the edge of nodes {first} and {second}; wanted one or two. Remove some."
                )
            if (first, second) in directed:
                raise ArgumentError(
                    f"mesh: faces {beside[0][0]} and {face} face opposite ways. Turn one of them round."
                )
            directed.add((first, second))
    return sides


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


def _masses(
    count: int, elements: Int[np.ndarray, "E K"], masses: Float[np.ndarray, " E"]
) -> Float[np.ndarray, " N"]:
    """Return the mass of each node [kg]: an equal share of each element at it."""
    corners = elements.shape[1]
    return np.bincount(elements.ravel(), np.repeat(masses / corners, corners), count)


def _squared_lengths(
    positions: Float[np.ndarray, "N 3"], edges: Int[np.ndarray, "P 2"]
) -> Float[np.ndarray, " P"]:
    extent = positions[edges[:, 1]] - positions[edges[:, 0]]
    return (extent**2).sum(axis=1)


def _check_nodes(
    positions: Float[np.ndarray, "N 3"], elements: Int[np.ndarray, "E K"], name: str
) -> None:
    count = len(positions)
    if not np.isfinite(positions).all():
        raise ArgumentError("mesh: a node's position is not finite.")
    if len(elements) == 0 or elements.min() < 0 or elements.max() >= count:
        raise ArgumentError(f"mesh: wanted {name}s of its {count} nodes.")
    unused = np.setdiff1d(np.arange(count), elements)
    if len(unused):
        raise ArgumentError(f"mesh: no {name} has the nodes {some(unused)}. Remove them.")
    _, first = np.unique(positions, axis=0, return_index=True)
    doubled = np.setdiff1d(np.arange(count), first)
    if len(doubled):
        raise ArgumentError(
            f"mesh: the nodes {some(doubled)} coincide with others. Merge vertices by distance."
        )


def _check_sizes(
    sizes: Float[np.ndarray, " E"],
    positions: Float[np.ndarray, "N 3"],
    power: int,
    name: str,
    size: str,
) -> None:
    extent = float(np.ptp(positions, axis=0).max())
    flat = np.flatnonzero(sizes < LEAST_SIZE * extent**power)
    if len(flat):
        raise ArgumentError(f"mesh: {name} {some(flat)} has no {size}. Remove it.")


def _check_pins(pins: Int[np.ndarray, " K"], count: int) -> None:
    wrong = pins[(pins < 0) | (pins >= count)]
    if len(wrong):
        raise ArgumentError(f"pins: {some(wrong)} are not nodes; the mesh has 0 to {count - 1}.")


def some(numbers: np.ndarray) -> str:
    """Return the first few of `numbers` as text, and whether there are more."""
    shown = ", ".join(map(str, numbers[:SHOWN].tolist()))
    return shown if len(numbers) <= SHOWN else f"{shown}, …"
