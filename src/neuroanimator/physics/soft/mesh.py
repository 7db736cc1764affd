"""A mesh at rest, its pieces, and what messages call its nodes and elements: by the numbers of its file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.appearance.shapes import MAX_NODES
from neuroanimator.errors import BadFileError
from neuroanimator.files.numbers import number_in
from neuroanimator.physics.pieces import pieces_of
from neuroanimator.physics.soft.soft_body import Points, tetrahedron_volumes

BYTES_A_NODE = 60_000
"""Memory for finding the shapes of a body [bytes per node]: snapshots of sixteen bodies."""

SHOWN = 3
"""Maximum number of nodes or elements a message names."""


Numbers = Int[np.ndarray, " _"]
"""Some nodes, elements or lines."""


class Mesh(NamedTuple):
    """A mesh at rest: of triangles, or of tetrahedra."""

    positions: Points
    """Positions of the nodes [m]."""
    elements: Int[np.ndarray, "E K"]
    """Corners of triangles (K = 3) or tetrahedra (K = 4)."""
    name: str = "mesh"
    """Name of its file."""
    numbers: Int[np.ndarray, " N"] | None = None
    """Number of each node in its file; None for a mesh of no file."""
    lines: Int[np.ndarray, " E"] | None = None
    """Line of its file that each element is on; None for a mesh of no file."""
    mended: tuple[str, ...] = ()
    """What was mended when it was read, in words."""
    groups: tuple[str, ...] = ()
    """Names of groups of elements."""
    members: Int[np.ndarray, " E"] | None = None
    """Number of each element's group; -1 for those in none. None if there are no groups."""

    def named_nodes(self, nodes: Numbers) -> str:
        """Return the first few of `nodes` by their numbers in the file."""
        if self.numbers is None:
            return f"nodes {some(nodes)}"
        return f"nodes {some(self.numbers[nodes])} of the file"

    def named_elements(self, elements: Numbers) -> str:
        """Return the first few of `elements` by their lines in the file."""
        kind = "triangles" if self.elements.shape[1] == 3 else "tetrahedra"
        if self.lines is None:
            return f"{kind} {some(elements)}"
        return f"{kind} of {named_lines(self.lines[elements])}"

    def pieces(self) -> Int[np.ndarray, " N"]:
        """Return the number of the piece each node belongs to, in the order of their first nodes."""
        return pieces_of(len(self.positions), self.elements)

    def only(self, elements: Numbers) -> Mesh:
        """Return the mesh of these `elements` and their nodes, in the same order."""
        nodes, corners = np.unique(self.elements[elements], return_inverse=True)
        return self._replace(
            positions=self.positions[nodes],
            elements=corners.reshape(-1, self.elements.shape[1]),
            numbers=None if self.numbers is None else self.numbers[nodes],
            lines=None if self.lines is None else self.lines[elements],
            members=None if self.members is None else self.members[elements],
        )

    def sizes(self) -> Float[np.ndarray, " E"]:
        """Return the area of each triangle [m²], or the signed volume of each tetrahedron [m³]."""
        if self.elements.shape[1] == 4:
            return tetrahedron_volumes(self.positions, self.elements)
        corners = self.positions[self.elements]
        edges = corners[:, 1:] - corners[:, :1]
        return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2


def some(numbers: np.ndarray) -> str:
    """Return the first few of `numbers` as text, and whether there are more."""
    shown = ", ".join(map(str, numbers[:SHOWN].tolist()))
    return shown if len(numbers) <= SHOWN else f"{shown}, …"


def named_lines(lines: Numbers) -> str:
    """Return the first few of `lines` of a file, each once."""
    distinct = np.unique(lines)
    return f"line {some(distinct)}" if len(distinct) == 1 else f"lines {some(distinct)}"


def coordinates(words: Sequence[str]) -> list[float]:
    """Return the first three of `words` as finite numbers; ValueError if they are none."""
    point = [number_in(word) for word in words[:3]]
    if len(point) < 3 or not np.isfinite(point).all():
        raise ValueError
    return point


def refuse_size(name: str, count: int) -> None:
    """Raise BadFileError for a mesh of more than `MAX_NODES` nodes."""
    if count > MAX_NODES:
        gigabytes = count * BYTES_A_NODE / 1e9
        raise BadFileError(
            f"{name}: {count:,} nodes, for which {gigabytes:,.0f} GB would be needed; wanted at most {MAX_NODES:,}. "
            "Make the mesh coarser."
        )
