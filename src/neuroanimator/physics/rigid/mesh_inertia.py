"""Meshes whose mass and inertia MuJoCo's modes disagree about: its default counts overlaps of a hollow shape twice."""

from __future__ import annotations

import mujoco
import numpy as np

from neuroanimator.executor.limited import LimitError, call_limited
from neuroanimator.physics.rigid.compiled_model import COMPILING, ModelRequest, quiet, spec_of
from neuroanimator.systems.model_files import ModelFiles
from neuroanimator.text import quoted

TOLERANCE = 0.1
"""Share of a body's mass or moment of inertia by which modes may differ unsaid."""

TINY = 1e-12
"""Mass or inertia by which none is divided [kg or kg·m²]."""

LEGACY = mujoco.mjtMeshInertia.mjMESH_INERTIA_LEGACY
EXACT = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
CONVEX = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
NAMES = {EXACT: "exact", CONVEX: "convex"}
"""MuJoCo's names of the modes that are held against its default."""


def mesh_warnings(files: ModelFiles, model: mujoco.MjModel) -> list[str]:
    """Return a warning on each mesh by which a body is heavier or harder to turn than by its true shape.

    The model of `files` has been compiled to `model`. One that takes too long to compile again is not checked.
    """
    if not model.nmesh:
        return []
    try:
        return call_limited(warnings_here, ModelRequest(files.main, files.documents()), COMPILING)
    except LimitError:
        return []


def warnings_here(request: ModelRequest) -> list[str]:
    """Return the warnings of `mesh_warnings`, found in this process."""
    with quiet():
        spec = spec_of(request)
        own = spec.compile()
        doubted = [mesh for mesh in spec.meshes if mesh.inertia == LEGACY]
        other = _compiled_otherwise(spec, doubted)
    if other is None or other.nbody != own.nbody:
        return []
    warnings = []
    for mesh in doubted:
        found = _difference(own, other, mesh.name)
        mode = NAMES[mesh.inertia]
        fix = f'Write inertia="{mode}" into that <mesh>, or an <inertial> into the body'
        if request.documents.is_urdf:
            fix = "Give its link an <inertial>"
        if found:
            warnings.append(f"mesh {quoted(mesh.name)}: {found.format(mode=mode)}. {fix}.")
    return warnings


def _compiled_otherwise(
    spec: mujoco.MjSpec, doubted: list[mujoco.MjsMesh]
) -> mujoco.MjModel | None:
    """Return the model with the exact inertia of all `doubted` meshes; with the convex one of those that are not closed."""
    for mesh in doubted:
        mesh.inertia = EXACT
    for _ in range(len(doubted) + 1):
        try:
            return spec.compile()
        except ValueError as error:
            for mesh in doubted:
                if f"name '{mesh.name}'" in str(error):
                    mesh.inertia = CONVEX
    return None


def _difference(own: mujoco.MjModel, other: mujoco.MjModel, mesh: str) -> str:
    """Return how the mass or a moment of inertia of a body with the `mesh` differs, where it does, to be filled with the mode."""
    is_mesh = own.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    is_mesh &= own.geom_dataid == own.mesh(mesh).id
    for body in sorted(set(own.geom_bodyid[is_mesh].tolist())):
        pairs = (
            ("the mass", "kg", own.body_mass[[body]], other.body_mass[[body]]),
            (
                "a moment of inertia",
                "kg·m²",
                np.sort(own.body_inertia[body]),
                np.sort(other.body_inertia[body]),
            ),
        )
        for what, unit, found, wanted in pairs:
            place = int(np.argmax(np.abs(found - wanted) / np.maximum(wanted, TINY)))
            if abs(found[place] - wanted[place]) > TOLERANCE * wanted[place]:
                return (
                    f"{what} of the body {quoted(own.body(body).name)} is {found[place]:.3g} {unit} by MuJoCo's default "
                    f"inertia, {wanted[place]:.3g} {unit} by the mesh's {{mode}} shape"
                )
    return ""
