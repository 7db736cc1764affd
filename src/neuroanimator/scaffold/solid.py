"""Proposal for a mesh of tetrahedra: a soft solid that lies on the ground, and a paddle that strikes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.files.atomic import read_bounded
from neuroanimator.files.tables import check_table
from neuroanimator.scaffold.cloth import rounded, usual_values
from neuroanimator.scaffold.flex import FREE_ROW
from neuroanimator.scaffold.proposal import Proposal
from neuroanimator.systems.soft.mesh_file import MAX_FILE, read_mesh
from neuroanimator.systems.soft.scene import Scene
from neuroanimator.systems.soft.soft_body import GRAVITY

DENSITY = 1000.0
"""Density [kg/m³]."""

SAG = 0.05
"""Strain at the bottom of a body as high as its size, under its own weight."""

HARDER = 10.0
"""Bulk modulus over Young's modulus."""

PADDLE = (0.1, 0.4, 0.4)
"""Half the size of the paddle, over the size of the body."""

GAP = 0.2
"""Distance of the paddle at rest from the body, over the size of the body."""

COMMENTS = {
    "mesh": "in metres, Z up",
    "substeps": "small steps in a super step",
    "shapes": "amplitudes that describe the body; more are more accurate and slower. Computed when first needed",
    "physics": "Small steps [s]: a user's, the teacher's, and the reference's.",
    "solid": "Material: density [kg/m³], stretch (Young's modulus) and bulk modulus [Pa], damping [s].",
    "ground": "A level plane: height [m].",
    "movers": "What moves: a control is its velocity, at most `speed` [m/s], and its turning rate. Its colliders strike; "
    "nodes that are its `pins` go with it.",
}
"""Comments on the values of the TOML file."""


def propose_solid(path: Path) -> Proposal:
    """Return a definition of the soft solid whose mesh is in the Gmsh file at `path`.

    Raises BadFileError or ArgumentError for a file that is not the mesh of a solid.
    """
    mesh = read_mesh(path.name, read_bounded(path, MAX_FILE))
    low = mesh.positions.min(axis=0)
    high = mesh.positions.max(axis=0)
    size = float((high - low).max())
    half = size * np.array(PADDLE)
    paddle = (low + high) / 2
    paddle[0] = low[0] - GAP * size - half[0]
    paddle[2] = low[2] + half[2]
    stretch = float(f"{-DENSITY * GRAVITY[2] * size / SAG:.2g}")
    values = usual_values(path) | {
        "solid": {"density": DENSITY, "stretch": stretch, "bulk": HARDER * stretch},
        "ground": {"height": rounded(low[2]), "friction": 0.5},
        "movers": {
            "paddle": {
                "position": rounded(paddle),
                "speed": [rounded(5 * size)] * 3,
                "reach": rounded(size * np.array([0.6, 0.4, 0.3])),
                "turns": True,
                "turn_speed": 3.0,
                "turn_reach": 0.5,
                "colliders": [{"box": rounded(half)}],
            },
        },
    }
    definition = check_table(values, path.name, SoftDefinition)
    Scene(definition, mesh)  # refuses invalid values
    count = f"{len(mesh.positions):,} nodes, {len(mesh.elements):,} tetrahedra, {size:g} m"
    told = (("mesh", count), FREE_ROW)
    parts = ("paddle", "paddle_heading", "position", "velocity")
    return Proposal(definition, COMMENTS, parts, told=told)
