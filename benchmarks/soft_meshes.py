"""The meshes of the soft bodies that ship, into the folder given: cape.obj, flag.obj.

python benchmarks/soft_meshes.py src/neuroanimator/systems/assets
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

CAPE = (70, 70)
"""Nodes down and around."""

FLAG = (40, 60)
"""Nodes down and along."""


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


def obj_text(positions: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "F 3"]) -> str:
    """Return a Wavefront OBJ file."""
    lines = [f"v {x:.5g} {y:.5g} {z:.5g}" for x, y, z in positions]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    return "\n".join(lines) + "\n"


def main() -> None:
    folder = Path(sys.argv[1])
    (folder / "cape.obj").write_text(obj_text(cape(*CAPE), grid_faces(*CAPE)))
    (folder / "flag.obj").write_text(obj_text(flag(*FLAG), grid_faces(*FLAG)))


if __name__ == "__main__":
    main()
