"""Proposal for a mesh: a cloth held by its upper edge, and a ball that strikes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.files.atomic import read_bounded
from neuroanimator.files.tables import check_table
from neuroanimator.scaffold.defaults import usual_name
from neuroanimator.scaffold.proposal import Proposal
from neuroanimator.systems.soft.mesh_file import MAX_FILE, Mesh, read_mesh
from neuroanimator.systems.soft.scene import Scene

STEP = 1 / 1200
"""Small physics step [s]."""

TRUTH_PARTS = 2
"""Number of the teacher's small steps in one of those."""

FINE_PARTS = 10
"""Number of the reference's small steps in one of those."""

EDGE = 0.01
"""Width of the upper edge, over the size of the mesh."""

BALL = 0.15
"""Radius of the ball, over the size of the mesh."""

AWAY = 0.6
"""Distance of the ball at rest, over the size of the mesh."""

COMMENTS = {
    "mesh": "in metres, Z up",
    "substeps": "small steps in a super step",
    "shapes": "amplitudes that describe the cloth; more are more accurate and slower. Computed when first needed",
    "physics": "Small steps [s]: a user's, the teacher's, and the reference's.",
    "cloth": "Material: density [kg/m²], stretch [N/m], bend [N/m], damping [s], thickness [m].",
    "air": "Air: drag [1/s], density [kg/m³], wind [m/s].",
    "movers": "What moves: a control is its velocity, at most `speed` [m/s]. It holds the nodes `pins`; its colliders strike.",
}
"""Comments on the values of the TOML file."""


def propose_cloth(path: Path) -> Proposal:
    """Return a definition of the cloth whose mesh is in the OBJ file at `path`.

    Raises BadFileError or ArgumentError for a file that is not the mesh of a cloth.
    """
    positions, faces = read_mesh(path.name, read_bounded(path, MAX_FILE))
    low = positions.min(axis=0)
    high = positions.max(axis=0)
    size = float((high - low).max())
    pins, edge = _held_edge(positions, size)
    middle = (low + high) / 2
    across = _thinnest_axis(positions)
    ball = middle + AWAY * size * across
    values = usual_values(path) | {
        "cloth": {"density": 0.2, "stretch": 20.0, "bend": 0.5, "thickness": rounded(0.01 * size)},
        "air": {"drag": 0.5, "density": 1.2, "wind": [0.0, 0.0, 0.0]},
        "movers": {
            "holder": {
                "position": rounded(positions[pins].mean(axis=0)),
                "speed": [rounded(0.5 * size)] * 3,
                "reach": [rounded(0.15 * size)] * 3,
                "pins": pins.tolist(),
            },
            "ball": {
                "position": rounded(ball),
                "speed": [rounded(size)] * 3,
                "reach": rounded(size * (0.25 + 0.75 * np.abs(across))),
                "colliders": [{"radius": rounded(BALL * size)}],
            },
        },
    }
    definition = check_table(values, path.name, SoftDefinition)
    Scene(definition, Mesh(positions, faces))  # refuses invalid values
    told = (
        ("mesh", f"{len(positions):,} nodes, {len(faces):,} triangles, {size:g} m"),
        ("held", f"{len(pins)} nodes: {edge}"),
    )
    parts = ("holder", "ball", "holder_velocity", "ball_velocity")
    return Proposal(definition, COMMENTS, parts, told=told)


def usual_values(path: Path) -> dict[str, Any]:
    """Return the values proposed for any soft body whose mesh is at `path`."""
    return {
        "name": usual_name(path),
        "kind": "soft",
        "mesh": path.name,
        "substeps": 40,
        "shapes": 96,
        "physics": {
            "step": STEP,
            "truth_step": STEP / TRUTH_PARTS,
            "fine_step": STEP / FINE_PARTS,
        },
    }


def _held_edge(positions: Float[np.ndarray, "N 3"], size: float) -> tuple[np.ndarray, str]:
    """Return the nodes of the upper edge, or of one side of a level mesh; and a name for them."""
    for axis, sign, name in ((2, 1, "the upper edge"), (0, -1, "the side of smallest x")):
        along = sign * positions[:, axis]
        if np.ptp(along) > EDGE * size:
            return np.flatnonzero(along > along.max() - EDGE * size), name
    return np.array([0]), "the first"


def _thinnest_axis(positions: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " 3"]:
    """Return the unit vector along which the mesh extends least."""
    _, _, axes = np.linalg.svd(positions - positions.mean(axis=0), full_matrices=False)
    return axes[-1]


def rounded(values: Any) -> Any:
    """Return numbers rounded for a TOML file, to whole micrometres."""
    return np.round(values, 6).tolist()
