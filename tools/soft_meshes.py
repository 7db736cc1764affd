"""The meshes of the soft bodies that ship, into the folder given: cape.obj, flag.obj, jelly.msh.

python -m tools.soft_meshes src/neuroanimator/systems/assets
"""

from __future__ import annotations

import argparse
from itertools import permutations
from pathlib import Path

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
    """Return six tetrahedra in each cell of the jelly's grid, around the cell's diagonal (Kuhn)."""
    nodes = np.arange(layers * side * side).reshape(layers, side, side)
    cells = []
    for axes in permutations(range(3)):
        offset = np.zeros(3, int)
        corners = [offset.copy()]
        for axis in axes:
            offset[axis] += 1
            corners.append(offset.copy())
        numbers = [
            nodes[k : layers - 1 + k, j : side - 1 + j, i : side - 1 + i].ravel()
            for k, j, i in corners
        ]
        cells.append(np.stack(numbers, axis=1))
    return np.concatenate(cells)


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


def msh_text(positions: Float[np.ndarray, "N 3"], tetrahedra: Int[np.ndarray, "T 4"]) -> str:
    """Return a Gmsh file, ASCII 2.2."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", str(len(positions))]
    for number, (x, y, z) in enumerate(positions, start=1):
        lines.append(f"{number} {x:.5g} {y:.5g} {z:.5g}")
    lines += ["$EndNodes", "$Elements", str(len(tetrahedra))]
    for number, (a, b, c, d) in enumerate(tetrahedra + 1, start=1):
        lines.append(f"{number} 4 2 0 1 {a} {b} {c} {d}")
    return "\n".join([*lines, "$EndElements"]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    (folder / "cape.obj").write_text(obj_text(cape(*CAPE), grid_faces(*CAPE)))
    (folder / "flag.obj").write_text(obj_text(flag(*FLAG), grid_faces(*FLAG)))
    nodes = jelly(*JELLY)
    (folder / "jelly.msh").write_text(msh_text(nodes, outward(nodes, grid_tetrahedra(*JELLY))))


if __name__ == "__main__":
    main()
