"""Vertices and faces of a Wavefront OBJ file, and nothing else."""

from __future__ import annotations

import re

import numpy as np

from neuroanimator.errors import BadFileError
from neuroanimator.files.numbers import whole_in
from neuroanimator.files.text_lines import TextError, text_lines
from neuroanimator.physics.soft.mesh import coordinates, refuse_size
from neuroanimator.physics.soft.soft_body import Points

MAX_CORNERS = 256
"""Maximum number of corners of a face."""

MAX_FACES = 1_000_000
"""Maximum number of faces: a surface has about two for each node."""

VERTEX = re.compile(rb"^\s*v\s", re.MULTILINE)
"""Beginning of a line with a vertex."""


def read_obj(name: str, content: bytes) -> tuple[Points, list[list[int]], list[int]]:
    """Return (positions of the vertices, corners of the faces, lines of the faces) in the file's order, unit and axes.

    Raises BadFileError naming the file and the line.
    """
    refuse_size(name, sum(1 for _ in VERTEX.finditer(content)))
    positions: list[list[float]] = []
    faces: list[list[int]] = []
    lines: list[int] = []
    number = 0
    wanted = ""
    try:
        for number, line in text_lines(content, "replace"):
            kind, *values = line.split(maxsplit=MAX_CORNERS + 1) or [""]
            if kind == "v":
                wanted = "three numbers"
                positions.append(coordinates(values))
            elif kind == "f":
                wanted = f"3 to {MAX_CORNERS} vertices of the file, in at most {MAX_FACES:,} faces"
                faces.append(_corners(values, len(positions)))
                lines.append(number)
                if len(faces) > MAX_FACES:
                    raise ValueError
    except TextError as error:
        raise BadFileError(f"{name}: {error}. Export it again.") from error
    except ValueError as error:
        raise BadFileError(f"{name}: line {number}: wanted {wanted}. Export it again.") from error
    if not faces:
        raise BadFileError(f"{name}: no faces. Export a surface as OBJ.")
    refuse_size(name, len(positions))
    return np.array(positions), faces, lines


def _corners(values: list[str], count: int) -> list[int]:
    """Return the indices of a face's vertices from 0: the file counts from 1, or backwards from the last one."""
    if not 3 <= len(values) <= MAX_CORNERS:
        raise ValueError
    corners = []
    for value in values:
        index = whole_in(value.split("/")[0])
        corner = index - 1 if index > 0 else count + index
        if not 0 <= corner < count:
            raise ValueError
        corners.append(corner)
    return corners
