"""Meshes of soft bodies in files: a cloth's triangles, or a solid's tetrahedra."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.definitions.soft import SOLID_ENDING
from neuroanimator.errors import BadFileError
from neuroanimator.systems.soft.meshes import refuse_size
from neuroanimator.systems.soft.msh_file import nodes_of_msh, read_msh
from neuroanimator.systems.soft.obj_file import read_obj

MAX_FILE = 256 * 2**20
"""Maximum size of a file [bytes]."""

MAX_LINES = 4_000_000
"""Maximum number of lines of a file."""


class Mesh(NamedTuple):
    """A mesh at rest."""

    positions: Float[np.ndarray, "N 3"]
    """Positions of the nodes [m]."""
    elements: Int[np.ndarray, "E K"]
    """Corners of triangles (K = 3) or tetrahedra (K = 4)."""


def read_mesh(name: str, content: bytes) -> Mesh:
    """Return the mesh in a file called `name`; BadFileError names the fault."""
    is_solid = name.endswith(SOLID_ENDING)
    told = nodes_of_msh(content) if is_solid else content.count(b"\nv ")
    refuse_size(name, told)
    if content.count(b"\n") > MAX_LINES:
        raise BadFileError(f"{name}: more than {MAX_LINES:,} lines. Make the mesh coarser.")
    read = read_msh if is_solid else read_obj
    positions, elements = read(name, content)
    refuse_size(name, len(positions))
    return Mesh(positions, elements)
