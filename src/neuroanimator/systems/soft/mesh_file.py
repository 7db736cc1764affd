"""Meshes of soft bodies in files: a cloth's triangles, or a solid's tetrahedra."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.definitions.soft import SOLID_ENDING
from neuroanimator.systems.soft.msh_file import read_msh
from neuroanimator.systems.soft.obj_file import read_obj

MAX_FILE = 64 * 2**20
"""Maximum size of a file [bytes]."""


class Mesh(NamedTuple):
    """A mesh at rest."""

    positions: Float[np.ndarray, "N 3"]
    """Positions of the nodes [m]."""
    elements: Int[np.ndarray, "E K"]
    """Corners of triangles (K = 3) or tetrahedra (K = 4)."""


def read_mesh(name: str, content: bytes) -> Mesh:
    """Return the mesh in a file called `name`; BadFileError names what is wrong with it."""
    read = read_msh if name.endswith(SOLID_ENDING) else read_obj
    return Mesh(*read(name, content))
