"""Meshes of soft bodies in files: a cloth's triangles, or a solid's tetrahedra, in metres and Z up."""

from __future__ import annotations

import numpy as np

from neuroanimator.definitions.soft import SOLID_ENDING, UNITS, MeshReading
from neuroanimator.errors import BadFileError
from neuroanimator.physics.soft.mesh import Mesh
from neuroanimator.physics.soft.msh_file import read_msh
from neuroanimator.physics.soft.obj_file import read_obj
from neuroanimator.physics.soft.polygons import triangulated
from neuroanimator.physics.soft.soft_body import Points

MAX_FILE = 256 * 2**20
"""Maximum size of a file [bytes]."""

MAX_LINES = 4_000_000
"""Maximum number of lines of a file."""

MAX_COORDINATE = 1e6
"""Largest coordinate in a file."""

AS_IT_IS = MeshReading()


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
