"""The meshes of the soft bodies that ship: cape.obj, flag.obj, jelly.msh, trout.msh and orca.msh.

python -m tools.soft_meshes src/neuroanimator/systems/assets
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

CAPE = (70, 70)
"""Nodes down and around."""

FLAG = (40, 60)
"""Nodes down and along."""

JELLY = (14, 12)
"""Nodes up, and along each side of a layer."""

FLUTES = 8
"""Number of flutes around the jelly."""

TROUT = (48, 11, 5)
"""Nodes along, up and across."""

TROUT_LENGTH = 0.4
"""Length of the trout [m]."""

FIN = 0.008
"""Least half thickness of the trout, that of its fins, over its length."""

TAIL = 0.86
"""Distance of its tail from its nose, over its length."""

FORK = 0.09
"""Depth of the notch in its tail, over its length."""

TROUT_SECTIONS = np.array(
    [
        [0.00, 0.012, -0.012, 0.012, -0.012, 0.012],
        [0.04, 0.040, -0.036, 0.040, -0.036, 0.028],
        [0.12, 0.070, -0.065, 0.070, -0.065, 0.046],
        [0.25, 0.100, -0.095, 0.100, -0.095, 0.060],
        [0.34, 0.120, -0.102, 0.108, -0.102, 0.062],
        [0.40, 0.160, -0.102, 0.108, -0.102, 0.062],
        [0.52, 0.130, -0.098, 0.098, -0.096, 0.056],
        [0.60, 0.092, -0.110, 0.084, -0.082, 0.047],
        [0.66, 0.075, -0.120, 0.070, -0.070, 0.040],
        [0.74, 0.056, -0.080, 0.054, -0.054, 0.029],
        [0.80, 0.044, -0.044, 0.042, -0.042, 0.021],
        [0.86, 0.060, -0.060, 0.036, -0.036, 0.014],
        [0.92, 0.105, -0.105, 0.030, -0.030, 0.010],
        [1.00, 0.150, -0.150, 0.020, -0.020, 0.008],
    ]
)
"""Sections of the trout from its nose to its tail, over its length: distance from the nose, top and bottom with fins, top,
bottom and half the width of the flesh."""

MUSCLES = {"front": (0.20, 0.45), "middle": (0.45, 0.68), "back": (0.68, 0.90)}
"""Beginning and end of the trout's bands of muscles, over its length; each has four, left and right, up and down."""

ORCA = (50, 13, 5)
"""Nodes along, across and up."""

ORCA_LENGTH = 6.0
"""Length of the orca [m]."""

ORCA_FINS = (0.016, 0.007)
"""Half thickness of the orca's fins at their roots and their tips, over its length."""

ORCA_FORK = 0.055
"""Depth of the notch in its tail, over its length."""

ORCA_SECTIONS = np.array(
    [
        [0.000, 0.020, 0.020, 0.012, -0.034],
        [0.020, 0.048, 0.048, 0.044, -0.058],
        [0.060, 0.068, 0.068, 0.066, -0.074],
        [0.120, 0.082, 0.082, 0.083, -0.086],
        [0.200, 0.093, 0.093, 0.098, -0.097],
        [0.235, 0.100, 0.096, 0.102, -0.100],
        [0.265, 0.150, 0.098, 0.104, -0.102],
        [0.300, 0.190, 0.099, 0.106, -0.103],
        [0.325, 0.185, 0.100, 0.107, -0.104],
        [0.370, 0.110, 0.100, 0.108, -0.104],
        [0.400, 0.099, 0.099, 0.107, -0.103],
        [0.500, 0.091, 0.091, 0.100, -0.095],
        [0.600, 0.074, 0.074, 0.084, -0.080],
        [0.700, 0.051, 0.051, 0.064, -0.060],
        [0.800, 0.034, 0.034, 0.047, -0.045],
        [0.870, 0.028, 0.028, 0.040, -0.040],
        [0.900, 0.060, 0.026, 0.032, -0.032],
        [0.940, 0.115, 0.024, 0.020, -0.020],
        [0.975, 0.145, 0.020, 0.012, -0.012],
        [1.000, 0.155, 0.020, 0.008, -0.008],
    ]
)
"""Sections of the orca from its nose to its tail, over its length: distance from the nose, half the width with fins and of
the flesh, top and bottom."""

ORCA_BACK_FIN = np.array([[0.39, 0.0], [0.46, 0.085], [0.485, 0.095], [0.55, 0.0]])
"""Height of the fin on its back at distances from the nose, over its length."""

ORCA_MUSCLES = {"front": (0.18, 0.40), "middle": (0.40, 0.60), "back": (0.60, 0.80)}
"""Beginning and end of the orca's bands of muscles, over its length."""


def grid_faces(rows: int, columns: int) -> Int[np.ndarray, "F 3"]:
    """Return the triangles of a grid of nodes, row by row; diagonals alternate, so that neither way is stiffer."""
    nodes = np.arange(rows * columns).reshape(rows, columns)
    corners = (nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:])
    a, b, c, d = (corner.ravel() for corner in corners)
    row, column = np.divmod(np.arange(len(a)), columns - 1)
    is_odd = ((row + column) % 2 == 1)[:, None]
    first = np.where(is_odd, np.stack([a, b, d], axis=1), np.stack([a, b, c], axis=1))
    second = np.where(is_odd, np.stack([b, c, d], axis=1), np.stack([a, c, d], axis=1))
    return np.concatenate([first, second])


def cape(rows: int, columns: int) -> Float[np.ndarray, "N 3"]:
    """Return the nodes of a half cone around the shoulders of somebody 1.7 m tall who looks along X [m]."""
    down = np.linspace(0, 1, rows)[:, None]
    around = np.radians(np.linspace(-90, 90, columns))
    flare = 1 + 1.3 * down
    x = -0.13 * flare * np.cos(around) - 0.02
    y = 0.21 * flare * np.sin(around)
    z = np.broadcast_to(1.45 - 1.1 * down, x.shape)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def sheet(side: int) -> Float[np.ndarray, "N 3"]:
    """Return the nodes of a square of 1 m × 1 m that hangs along -Z from a height of 1.5 m [m]."""
    z, x = np.meshgrid(1.5 - np.linspace(0, 1, side), np.linspace(-0.5, 0.5, side), indexing="ij")
    return np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)


def flag(rows: int, columns: int) -> Float[np.ndarray, "N 3"]:
    """Return the nodes of a flag of 1.2 m × 0.8 m at the top of a pole of 2 m [m]: wavy, for a plane one hangs as a plate."""
    z, x = np.meshgrid(2.0 - np.linspace(0, 0.8, rows), np.linspace(0, 1.2, columns), indexing="ij")
    y = 0.03 * np.sin(1.5 * np.pi * x / 1.2) * (x / 1.2)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def jelly(layers: int, side: int) -> Float[np.ndarray, "N 3"]:
    """Return the nodes of a fluted jelly, 0.14 m high, that stands on the ground [m]."""
    line = np.linspace(-1, 1, side)
    height, y, x = np.meshgrid(np.linspace(0, 1, layers), line, line, indexing="ij")
    radius = np.maximum(np.abs(x), np.abs(y))  # squares of the grid become circles
    angle = np.arctan2(y, x)
    outer = 0.11 * (1 - 0.3 * height**1.5) * (1 + 0.06 * radius * np.cos(FLUTES * angle))
    nodes = [radius * outer * np.cos(angle), radius * outer * np.sin(angle), 0.14 * height]
    return np.stack(nodes, axis=-1).reshape(-1, 3)


def grid_tetrahedra(layers: int, side: int) -> Int[np.ndarray, "T 4"]:
    """Return six tetrahedra in each cell of the jelly's grid."""
    return kuhn_tetrahedra((layers, side, side))


def kuhn_tetrahedra(shape: tuple[int, int, int]) -> Int[np.ndarray, "T 4"]:
    """Return six tetrahedra in each cell of a grid, around the cell's diagonal (Kuhn)."""
    nodes = np.arange(np.prod(shape)).reshape(shape)
    first, second, third = (count - 1 for count in shape)
    cells = []
    for axes in permutations(range(3)):
        offset = np.zeros(3, int)
        corners = [offset.copy()]
        for axis in axes:
            offset[axis] += 1
            corners.append(offset.copy())
        numbers = [
            nodes[k : first + k, j : second + j, i : third + i].ravel() for k, j, i in corners
        ]
        cells.append(np.stack(numbers, axis=1))
    return np.concatenate(cells)


def trout(along: int, up: int, across: int) -> Float[np.ndarray, "N 3"]:
    """Return the nodes of a trout, its nose at the origin, that looks along X [m]; its image in the plane Y = 0 is itself."""
    distance = np.linspace(0, 1, along)
    columns = TROUT_SECTIONS.T
    top, bottom, back, belly, width = (
        np.interp(distance, columns[0], column)[:, None] for column in columns[1:]
    )
    height = (top + bottom) / 2 + (top - bottom) / 2 * np.linspace(-1, 1, up)
    off = (2 * height - back - belly) / (back - belly)
    half = np.maximum(width * np.sqrt(np.clip(1 - off**2, 0, None)), FIN)
    y = half[:, :, None] * np.linspace(-1, 1, across)
    in_tail = np.clip((distance - TAIL) / (1 - TAIL), 0, None)[:, None]
    notch = FORK * in_tail * (1 - np.abs(np.linspace(-1, 1, up))) ** 1.5
    x = np.broadcast_to((notch - distance[:, None])[:, :, None], y.shape)
    z = np.broadcast_to(height[:, :, None], y.shape)
    return TROUT_LENGTH * np.stack([x, y, z], axis=-1).reshape(-1, 3)


def mirrored_tetrahedra(shape: tuple[int, int, int]) -> Int[np.ndarray, "T 4"]:
    """Return six tetrahedra in each cell of a grid, those on the right the mirror images of those on the left."""
    along, up, across = shape
    middle = across // 2 + 1
    left = np.arange(along * up * across).reshape(shape)[:, :, :middle]
    right = np.arange(along * up * across).reshape(shape)[:, :, : middle - 2 : -1]
    halves = kuhn_tetrahedra((along, up, middle))
    return np.concatenate([left.ravel()[halves], right.ravel()[halves]])


def orca(along: int, across: int, up: int) -> Float[np.ndarray, "N 3"]:
    """Return the nodes of an orca, its nose at the origin, that looks along X [m]; its image in the plane Y = 0 is itself."""
    distance = np.linspace(0, 1, along)
    columns = ORCA_SECTIONS.T
    fins, width, top, bottom = (
        np.interp(distance, columns[0], column)[:, None] for column in columns[1:]
    )
    side = np.linspace(-1, 1, across)
    side = 0.4 * side + 0.6 * np.sin(np.pi / 2 * side)  # closer at the sides, which are round
    y = fins * side
    half = (top - bottom) / 2 * np.sqrt(np.clip(1 - (y / width) ** 2, 0, None))
    half = np.maximum(half, np.interp(np.abs(side), (0.0, 1.0), ORCA_FINS))
    # Flippers point down and back, the tail has a notch.
    in_flipper = np.clip(np.abs(y) - width, 0, None) * (distance < 0.5)[:, None]
    z = (top + bottom) / 2 - 0.6 * in_flipper
    z = z[:, :, None] + half[:, :, None] * np.linspace(-1, 1, up)
    in_tail = np.clip((distance - TAIL) / (1 - TAIL), 0, None)[:, None]
    x = ORCA_FORK * in_tail * (1 - np.abs(side)) ** 1.5 - distance[:, None] - 0.3 * in_flipper
    x = np.repeat(x[:, :, None], up, axis=2)
    # The upper nodes in the middle are raised to a fin.
    fin = np.interp(distance, *ORCA_BACK_FIN.T)
    for layer, share in ((-1, 1.0), (-2, 0.35)):
        z[:, across // 2, layer] += share * fin
        x[:, across // 2, layer] -= 0.4 * share * fin
    y = np.repeat(y[:, :, None], up, axis=2)
    return ORCA_LENGTH * np.stack([x, y, z], axis=-1).reshape(-1, 3)


def quarters(
    bands: dict[str, tuple[float, float]],
    length: float,
    centres: Float[np.ndarray, "T 3"],
    middle: float | Float[np.ndarray, " T"] = 0.0,
) -> tuple[list[str], Int[np.ndarray, " T"]]:
    """Return the names of muscles in `bands`, each left and right, above and below `middle` [m], and each tetrahedron's.

    Numbers count from 1; 0 is for none.
    """
    x, y, z = centres.T
    names = []
    numbers = np.zeros(len(centres), int)
    for band, (first, last) in bands.items():
        is_within = (-x >= first * length) & (-x < last * length)
        for side, is_left in (("l", y > 0), ("r", y < 0)):
            for level, is_up in (("u", z > middle), ("d", z <= middle)):
                names.append(f"{band}_{side}{level}")
                numbers[is_within & is_left & is_up] = len(names)
    return names, numbers


class Animal(NamedTuple):
    """The mesh of an animal of flesh."""

    nodes: Float[np.ndarray, "N 3"]
    tetrahedra: Int[np.ndarray, "T 4"]
    names: list[str]
    """Names of its muscles."""
    muscles: Int[np.ndarray, " T"]
    """Number of the muscle of each tetrahedron, from 1; 0 for none."""


def trout_animal(shape: tuple[int, ...]) -> Animal:
    """Return the trout with so many nodes along, up and across."""
    along, up, across = shape
    nodes = trout(along, up, across)
    tetrahedra = outward(nodes, mirrored_tetrahedra((along, up, across)))
    grouped = quarters(MUSCLES, TROUT_LENGTH, nodes[tetrahedra].mean(axis=1))
    return Animal(nodes, tetrahedra, *grouped)


def orca_animal(shape: tuple[int, ...]) -> Animal:
    """Return the orca with so many nodes along, across and up."""
    along, across, up = shape
    nodes = orca(along, across, up)
    grid = np.arange(len(nodes)).reshape(along, across, up).transpose(0, 2, 1).ravel()
    tetrahedra = outward(nodes, grid[mirrored_tetrahedra((along, up, across))])
    centres = nodes[tetrahedra].mean(axis=1)
    distance = -centres[:, 0] / ORCA_LENGTH
    columns = ORCA_SECTIONS.T
    width, top, bottom = (
        ORCA_LENGTH * np.interp(distance, columns[0], column) for column in columns[2:]
    )
    names, muscles = quarters(ORCA_MUSCLES, ORCA_LENGTH, centres, (top + bottom) / 2)
    muscles[np.abs(centres[:, 1]) > width] = 0  # fins
    return Animal(nodes, tetrahedra, names, muscles)


def outward(
    positions: Float[np.ndarray, "N 3"], tetrahedra: Int[np.ndarray, "T 4"]
) -> Int[np.ndarray, "T 4"]:
    """Return the tetrahedra, two corners swapped of those that are inside out."""
    corners = positions[tetrahedra]
    is_inverted = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    swapped = tetrahedra[:, [0, 2, 1, 3]]
    return np.where(is_inverted[:, None], swapped, tetrahedra)


def obj_text(positions: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "F 3"]) -> str:
    """Return a Wavefront OBJ file."""
    lines = [f"v {x:.5g} {y:.5g} {z:.5g}" for x, y, z in positions]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    return "\n".join(lines) + "\n"


def msh_text(
    positions: Float[np.ndarray, "N 3"],
    tetrahedra: Int[np.ndarray, "T 4"],
    names: Sequence[str] = (),
    groups: Int[np.ndarray, " T"] | None = None,
) -> str:
    """Return a Gmsh file, ASCII 2.2; `groups` are the numbers of the tetrahedra's physical groups, `names` those from 1."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    if names:
        told = [f'3 {number} "{name}"' for number, name in enumerate(names, start=1)]
        lines += ["$PhysicalNames", str(len(names)), *told, "$EndPhysicalNames"]
    lines += ["$Nodes", str(len(positions))]
    for number, (x, y, z) in enumerate(positions, start=1):
        lines.append(f"{number} {x:.5g} {y:.5g} {z:.5g}")
    lines += ["$EndNodes", "$Elements", str(len(tetrahedra))]
    if groups is None:
        groups = np.zeros(len(tetrahedra), int)
    for number, ((a, b, c, d), group) in enumerate(
        zip(tetrahedra + 1, groups, strict=True), start=1
    ):
        lines.append(f"{number} 4 2 {group} 1 {a} {b} {c} {d}")
    return "\n".join([*lines, "$EndElements"]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="of those that ship")
    folder = parser.parse_args().folder
    (folder / "cape.obj").write_text(obj_text(cape(*CAPE), grid_faces(*CAPE)))
    (folder / "flag.obj").write_text(obj_text(flag(*FLAG), grid_faces(*FLAG)))
    nodes = jelly(*JELLY)
    (folder / "jelly.msh").write_text(msh_text(nodes, outward(nodes, grid_tetrahedra(*JELLY))))
    (folder / "trout.msh").write_text(msh_text(*trout_animal(TROUT)))
    (folder / "orca.msh").write_text(msh_text(*orca_animal(ORCA)))


if __name__ == "__main__":
    main()
