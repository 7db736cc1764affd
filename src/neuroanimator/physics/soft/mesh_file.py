"""Meshes of soft bodies in files: a cloth's triangles, or a solid's tetrahedra, in metres and Z up."""

from __future__ import annotations

import re

import numpy as np

from neuroanimator.definitions.soft import SOLID_ENDING, UNITS, MeshReading
from neuroanimator.errors import BadFileError
from neuroanimator.files.numbers import whole_in
from neuroanimator.files.text_lines import TextError, text_lines
from neuroanimator.physics.soft.mesh import Mesh, coordinates, refuse_size
from neuroanimator.physics.soft.msh_file import read_msh
from neuroanimator.physics.soft.polygons import triangulated
from neuroanimator.physics.soft.soft_body import Points

MAX_FILE = 256 * 2**20
"""Maximum size of a file [bytes]."""

MAX_LINES = 4_000_000
"""Maximum number of lines of a file."""

MAX_COORDINATE = 1e6
"""Largest coordinate in a file."""

AS_IT_IS = MeshReading()

MAX_CORNERS = 256
"""Maximum number of corners of a face."""

MAX_FACES = 1_000_000
"""Maximum number of faces: a surface has about two for each node."""

VERTEX = re.compile(rb"^\s*v\s", re.MULTILINE)
"""Beginning of a line with a vertex."""


def read_mesh(name: str, content: bytes, reading: MeshReading = AS_IT_IS) -> Mesh:
    """Return the mesh in a file called `name`, in metres, Z up; BadFileError names the fault."""
    is_solid = name.endswith(SOLID_ENDING)
    if content.count(b"\n") > MAX_LINES:
        raise BadFileError(f"{name}: more than {MAX_LINES:,} lines. Make the mesh coarser.")
    if is_solid:
        mesh = read_msh(name, content)
        _refuse_far(name, mesh.positions)
    else:
        vertices, faces, lines = read_obj(name, content)
        _refuse_far(name, vertices)
        mesh = triangulated(name, vertices, faces, lines)
    positions = mesh.positions
    if reading.up == "y":
        x, y, z = positions.T
        positions = np.stack([x, -z, y], axis=1)
    mesh = mesh._replace(positions=UNITS[reading.unit] * positions)
    if reading.keep == "all":
        return mesh
    pieces = mesh.pieces()[mesh.elements[:, 0]]
    largest = np.bincount(pieces, np.abs(mesh.sizes())).argmax()
    return mesh.only(np.flatnonzero(pieces == largest))


def _refuse_far(name: str, positions: Points) -> None:
    """Raise BadFileError for a coordinate that is too large."""
    largest = np.abs(positions).max()
    if largest > MAX_COORDINATE:
        raise BadFileError(
            f"{name}: a coordinate of {largest:.3g}; wanted at most {MAX_COORDINATE:,.0f}. Move the mesh to the origin."
        )


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
