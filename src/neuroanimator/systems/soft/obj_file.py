"""Vertices and faces of a Wavefront OBJ file, and nothing else."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import BadFileError

MAX_CORNERS = 256
"""Maximum number of corners of a face."""


def read_obj(
    name: str, content: bytes
) -> tuple[Float[np.ndarray, "N 3"], list[list[int]], list[int]]:
    """Return (positions of the vertices, corners of the faces, lines of the faces) in the file's order, unit and axes.

    Raises BadFileError naming the file and the line.
    """
    positions: list[list[float]] = []
    faces: list[list[int]] = []
    lines: list[int] = []
    for number, line in enumerate(content.decode("utf-8", errors="replace").split("\n"), start=1):
        kind, *values = line.split() or [""]
        try:
            if kind == "v":
                position = [float(value) for value in values[:3]]
                if len(position) < 3 or not np.isfinite(position).all():
                    raise ValueError
                positions.append(position)
            elif kind == "f":
                corners = [_corner(value, len(positions)) for value in values[: MAX_CORNERS + 1]]
                if not 3 <= len(corners) <= MAX_CORNERS:
                    raise ValueError
                faces.append(corners)
                lines.append(number)
        except ValueError as error:
            wanted = "three numbers" if kind == "v" else f"3 to {MAX_CORNERS} vertices of the file"
            raise BadFileError(
                f"{name}: line {number}: wanted {wanted}. Export it again."
            ) from error
    if not faces:
        raise BadFileError(f"{name}: no faces. Export a surface as OBJ.")
    return np.array(positions), faces, lines


def _corner(text: str, count: int) -> int:
    """Return the index of a vertex from 0: the file counts from 1, or backwards from the last one."""
    index = int(text.split("/")[0])
    number = index - 1 if index > 0 else count + index
    if not 0 <= number < count:
        raise ValueError
    return number
