"""A cube of tetrahedra as a Gmsh file, for tests."""

from __future__ import annotations

from itertools import product

import numpy as np


def cube(cells: int = 3, size: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes [m] and tetrahedra of a cube that stands on the origin."""
    line = np.linspace(0, size, cells + 1)
    positions = np.array(list(product(line - size / 2, line - size / 2, line)))
    nodes = np.arange((cells + 1) ** 3).reshape([cells + 1] * 3)
    found = []
    for i, j, k in product(range(cells), repeat=3):
        corner = nodes[i : i + 2, j : j + 2, k : k + 2]
        for axes in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
            place = np.zeros(3, int)
            path = [corner[tuple(place)]]
            for axis in axes:
                place[axis] = 1
                path.append(corner[tuple(place)])
            found.append(path)
    tetrahedra = np.array(found)
    corners = positions[tetrahedra]
    inverted = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    tetrahedra[inverted] = tetrahedra[inverted][:, [1, 0, 2, 3]]
    return positions, tetrahedra


def msh_2(positions: np.ndarray, tetrahedra: np.ndarray) -> str:
    """Return a file of version 2.2: with a triangle among the elements, and nodes numbered from 1."""
    rows = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", str(len(positions))]
    rows += [f"{tag} {x!r} {y!r} {z!r}" for tag, (x, y, z) in enumerate(positions.tolist(), 1)]
    rows += ["$EndNodes", "$Elements", str(len(tetrahedra) + 1), "1 2 2 0 1 1 2 3"]
    for tag, corners in enumerate((tetrahedra + 1).tolist(), 2):
        rows.append(f"{tag} 4 2 0 1 {' '.join(map(str, corners))}")
    return "\n".join([*rows, "$EndElements", ""])


def msh_4(positions: np.ndarray, tetrahedra: np.ndarray) -> str:
    """Return a file of version 4.1: nodes in two blocks, and a block of triangles."""
    count = len(positions)
    half = count // 2
    rows = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$Nodes", f"2 {count} 1 {count}"]
    for first, last in ((0, half), (half, count)):
        rows.append(f"3 1 0 {last - first}")
        rows += [str(tag + 1) for tag in range(first, last)]
        rows += [f"{x!r} {y!r} {z!r}" for x, y, z in positions[first:last].tolist()]
    total = len(tetrahedra) + 1
    rows += ["$EndNodes", "$Elements", f"2 {total} 1 {total}", "2 1 2 1", "1 1 2 3"]
    rows.append(f"3 1 4 {len(tetrahedra)}")
    for tag, corners in enumerate((tetrahedra + 1).tolist(), 2):
        rows.append(f"{tag} {' '.join(map(str, corners))}")
    return "\n".join([*rows, "$EndElements", ""])
