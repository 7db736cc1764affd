"""The soft bodies that ship by meshes of any fineness, and what moves from one mesh to another."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.physics.soft.mesh import Mesh
from neuroanimator.physics.soft.scene import Scene
from tools.soft_meshes import (
    CAPE,
    FLAG,
    JELLY,
    ORCA,
    TROUT,
    Animal,
    cape,
    flag,
    grid_faces,
    grid_tetrahedra,
    jelly,
    orca_animal,
    outward,
    trout_animal,
)

Shape = tuple[int, ...]
"""Number of nodes along each side of a grid."""


class Family(NamedTuple):
    """A body's meshes: grids of nodes, row by row."""

    shape: Shape
    """Of the mesh that ships."""
    nodes: Callable[[Shape], Float[np.ndarray, "N 3"] | Animal]
    pins: Callable[[Shape], Int[np.ndarray, " K"]]
    """Returns the nodes that the one mover holds."""
    opponents: tuple[tuple[float, tuple[int, ...]], ...]
    """Share of the nodes along each side, and numbers of small steps a super step, of cheaper physics."""
    across: int | None = None
    """Side of an animal's grid from left to right, whose middle nodes lie in its plane of symmetry; None for no animal."""

    def shape_at(self, share: float) -> Shape:
        """Return the grid of a `share` of the nodes along each side."""
        shape = [max(3, round(share * count)) for count in self.shape]
        if self.across is not None:
            shape[self.across] |= 1
        return tuple(shape)

    def mesh(self, shape: Shape) -> Mesh:
        """Return the mesh of this grid."""
        nodes = self.nodes(shape)
        if isinstance(nodes, Animal):
            groups = tuple(nodes.names)
            return Mesh(nodes.nodes, nodes.tetrahedra, groups=groups, members=nodes.muscles - 1)
        if len(shape) == 2:
            return Mesh(nodes, grid_faces(*shape))
        layers, side, _ = shape
        return Mesh(nodes, outward(nodes, grid_tetrahedra(layers, side)))

    def scene(self, definition: SoftDefinition, shape: Shape) -> Scene:
        """Return the physics of the body that `definition` is of, by another mesh; ArgumentError where that cannot be."""
        pins = tuple(self.pins(shape).tolist())
        movers = {
            name: mover.model_copy(update={"pins": pins}) if mover.pins else mover
            for name, mover in definition.movers.items()
        }
        return Scene(definition.model_copy(update={"movers": movers}), self.mesh(shape))


CLOTH_OPPONENTS = (
    (1.0, (160, 80, 60, 40, 20)),
    (0.7, (80, 40, 20)),
    (0.5, (80, 40, 20, 10)),
    (0.35, (40, 20, 10)),
    (0.2, (20, 10, 5)),
)
"""Of a cloth; `Family.opponents`."""

FAMILIES = {
    "cape": Family(
        CAPE,
        lambda shape: cape(*shape),
        lambda shape: np.arange(shape[1]),
        CLOTH_OPPONENTS,
    ),
    "flag": Family(
        FLAG,
        lambda shape: flag(*shape),
        lambda shape: np.arange(shape[0]) * shape[1],
        CLOTH_OPPONENTS,
    ),
    "jelly": Family(
        (*JELLY, JELLY[1]),
        lambda shape: jelly(*shape[:2]),
        lambda shape: np.arange(shape[1] * shape[2]),
        (
            (1.0, (160, 80, 60, 40, 20)),
            (0.7, (80, 40, 20)),
            (0.5, (40, 20, 10)),
            (0.35, (20, 10, 5)),
        ),
    ),
    "trout": Family(
        TROUT,
        trout_animal,
        lambda shape: np.zeros(0, int),
        (
            (1.0, (64, 32, 16, 8, 4, 2)),
            (0.7, (32, 16, 8, 4, 2)),
            (0.5, (32, 16, 8, 4, 2)),
            (0.35, (16, 8, 4, 2)),
        ),
        across=2,
    ),
    "orca": Family(
        ORCA,
        orca_animal,
        lambda shape: np.zeros(0, int),
        (
            (1.0, (80, 64, 40, 20, 10)),
            (0.7, (64, 40, 20, 10)),
            (0.5, (64, 40, 20, 10, 5)),
            (0.35, (40, 20, 10, 5)),
        ),
        across=1,
    ),
}
"""Every soft body that ships."""


def resampled(
    values: Float[np.ndarray, "*T N 3 L"], shape: Shape, wanted: Shape
) -> Float[np.ndarray, "*T M 3 L"]:
    """Return what nodes of a grid have, interpolated linearly along each side at the nodes of the `wanted` grid."""
    lead = values.shape[:-3]
    grid = values.reshape(-1, *shape, *values.shape[-2:])
    for axis, (count, other) in enumerate(zip(shape, wanted, strict=True), start=1):
        matrix = _between(count, other)
        grid = np.moveaxis(np.tensordot(matrix, grid, axes=(1, axis)), 0, axis)
    return grid.reshape(*lead, -1, *values.shape[-2:])


def _between(count: int, other: int) -> Float[np.ndarray, "M N"]:
    """Return the matrix that interpolates linearly from `count` to `other` points of a line."""
    points = np.linspace(0, 1, count)
    rows = [np.interp(np.linspace(0, 1, other), points, unit) for unit in np.eye(count)]
    return np.stack(rows, axis=1)
