"""A skin in a GLB file: one mesh whose points follow the bones' nodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from neuroanimator.export.glb import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer, float32
from neuroanimator.systems.rotation import rotation_matrices
from neuroanimator.systems.skeleton import Skeleton
from neuroanimator.systems.skin_mesh import colours_of, skin_mesh

SCREEN_GAMMA = 2.2
"""Colours are meant for the screen; those of glTF's points are linear."""


def skin_mesh_object(skeleton: Skeleton, name: str, material: int, buffer: Buffer) -> dict[str, Any]:
    """Return the mesh of the skeleton's skin at rest."""
    assert skeleton.skin is not None
    mesh = skin_mesh(skeleton)
    colours = colours_of(skeleton.skin, mesh.shades) ** SCREEN_GAMMA
    attributes = {
        "POSITION": buffer.add(float32(mesh.points), "VEC3", target=ARRAY_BUFFER, bounds=True),
        "NORMAL": buffer.add(float32(mesh.normals), "VEC3", target=ARRAY_BUFFER),
        "COLOR_0": buffer.add(float32(colours), "VEC3", target=ARRAY_BUFFER),
        "JOINTS_0": buffer.add(_listed(mesh.bones, mesh.weights), "VEC4", target=ARRAY_BUFFER),
        "WEIGHTS_0": buffer.add(float32(mesh.weights), "VEC4", target=ARRAY_BUFFER),
    }
    indices = buffer.add(mesh.triangles.astype(np.uint16).ravel(), "SCALAR", target=ELEMENT_ARRAY_BUFFER)
    return {"name": name, "primitives": [{"attributes": attributes, "indices": indices, "material": material}]}


def skin_object(skeleton: Skeleton, root: int, buffer: Buffer) -> dict[str, Any]:
    """Return the skin: bones as joints, after the node `root`, and what takes points at rest into their frames."""
    matrices = np.zeros((len(skeleton.bones), 4, 4))
    for matrix, bone in zip(matrices, skeleton.bones, strict=True):
        back = rotation_matrices(np.array(bone.turn)).T
        matrix[:3, :3], matrix[:3, 3], matrix[3, 3] = back, -back @ np.array(bone.offset), 1
    columns = float32(matrices.transpose(0, 2, 1))
    joints = list(range(root + 1, root + 1 + len(skeleton.bones)))
    return {"joints": joints, "inverseBindMatrices": buffer.add(columns, "MAT4"), "skeleton": root}


def skin_material(opacity: float) -> dict[str, Any]:
    """Return a wet surface; its colour is that of its points."""
    surface = {"baseColorFactor": [1, 1, 1, opacity], "metallicFactor": 0.0, "roughnessFactor": 0.45}
    return {"pbrMetallicRoughness": surface} | ({"alphaMode": "BLEND"} if opacity < 1 else {})


def _listed(bones: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the bones' numbers, 0 where they do not count, as the format wants."""
    return np.where(weights > 0, bones, 0).astype(np.uint16)
