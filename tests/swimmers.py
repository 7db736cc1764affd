"""A coarse trout with muscles, in water."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.soft_meshes import msh_text, trout_animal

COARSE = (16, 5, 3)
"""Nodes along, up and across."""

MUSCLES = [
    f"{band}_{side}{level}"
    for band in ("front", "middle", "back")
    for side in "lr"
    for level in "ud"
]

WATER = "face_drag = 300.0\nrighting = 0.004"


def mesh_text(shape: tuple[int, int, int] = COARSE) -> str:
    """Return the Gmsh file of a trout with twelve groups of tetrahedra."""
    return msh_text(*trout_animal(shape))


def swimmer(folder: Path, water: str = WATER, more: str = "", muscles: str = "") -> Path:
    """Return the TOML file of a trout in `folder`; `more` are further tables, `muscles` rows of another mesh's muscles."""
    (folder / "trout.msh").write_text(mesh_text())
    rows = muscles or "\n".join(f"{name} = [1, 0, 0]" for name in MUSCLES)
    path = folder / "trout.toml"
    path.write_text(
        f"""
name = "trout"
kind = "soft"
mesh = "trout.msh"
substeps = 16
shapes = 12

[physics]
step = 0.002
truth_step = 0.002
fine_step = 0.0002

[solid]
damping = 0.004

[muscles.along]
{rows}

[water]
{water}

{more}
"""
    )
    return path


def mirrored_states(system, states: np.ndarray) -> np.ndarray:
    """Return what `states` are in the mirror that reverses Y."""
    image = np.array(states)
    for part, axes in (("position", [1]), ("velocity", [1]), ("angular_velocity", [0, 2])):
        image[..., np.array(axes) + system.state.index(part).start] *= -1
    image[..., np.array([1, 3]) + system.state.index("orientation").start] *= -1
    swimmer = system.structure.swimmer
    signs = np.where(swimmer.odd[3 : 3 + len(system.shapes.modes)], -1, 1)
    for part in ("shapes", "shape_rates"):
        image[..., system.state.index(part)] *= signs
    partners = list(system.structure.mirror.controls)
    image[..., system.activations] = states[..., system.activations][..., partners]
    return image
