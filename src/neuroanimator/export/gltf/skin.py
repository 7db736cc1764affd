"""A skin in a GLB file: one mesh whose points follow the bones' nodes, a primitive for each of its parts."""

from __future__ import annotations

from typing import Any

import numpy as np

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin import Box
from neuroanimator.appearance.skin_mesh import BACK, EYE, FIN, colours_of, skin_mesh
from neuroanimator.export.gltf.buffers import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer, float32
from neuroanimator.export.gltf.colour import linear_of
from neuroanimator.export.gltf.materials import material
from neuroanimator.state.rotation import rotation_matrices

PARTS = ("body", "fin", "eye")
"""Of a swimmer, by shade; a box is all body."""


def skin_primitives(skeleton: Skeleton, buffer: Buffer) -> dict[str, dict[str, Any]]:
    """Return, for each part of the skin there is, its primitive without a material: the points are shared."""
    assert skeleton.skin is not None
    mesh = skin_mesh(skeleton)
    colours = linear_of(colours_of(skeleton.skin, mesh.shades))
    attributes = {
        "POSITION": buffer.add(float32(mesh.points), "VEC3", target=ARRAY_BUFFER, bounds=True),
        "NORMAL": buffer.add(float32(mesh.normals), "VEC3", target=ARRAY_BUFFER),
        "COLOR_0": buffer.add(float32(colours), "VEC3", target=ARRAY_BUFFER),
        "JOINTS_0": buffer.add(_listed(mesh.bones, mesh.weights), "VEC4", target=ARRAY_BUFFER),
        "WEIGHTS_0": buffer.add(float32(mesh.weights), "VEC4", target=ARRAY_BUFFER),
    }
    shades = mesh.shades[mesh.triangles].max(axis=1)
    part = np.zeros(len(shades), int)
    if not isinstance(skeleton.skin, Box):
        part = np.digitize(shades, [(BACK + FIN) / 2, (FIN + EYE) / 2])
    primitives = {}
    for number, name in enumerate(PARTS):
        triangles = mesh.triangles[part == number]
        if len(triangles):
            indices = buffer.add(
                triangles.astype(np.uint16).ravel(), "SCALAR", target=ELEMENT_ARRAY_BUFFER
            )
            primitives[name] = {"attributes": attributes, "indices": indices}
    return primitives


def skin_object(skeleton: Skeleton, name: str, root: int, buffer: Buffer) -> dict[str, Any]:
    """Return the skin: bones as joints, after the node `root`, and what takes points at rest into their frames."""
    matrices = np.zeros((len(skeleton.bones), 4, 4))
    for matrix, bone in zip(matrices, skeleton.bones, strict=True):
        back = rotation_matrices(np.array(bone.orientation)).T
        matrix[:3, :3], matrix[:3, 3], matrix[3, 3] = back, -back @ np.array(bone.offset), 1
    columns = float32(matrices.transpose(0, 2, 1))
    joints = list(range(root + 1, root + 1 + len(skeleton.bones)))
    return {
        "name": name,
        "joints": joints,
        "inverseBindMatrices": buffer.add(columns, "MAT4"),
        "skeleton": root,
    }


def skin_material(part: str) -> dict[str, Any]:
    """Return a wet surface; its colour is that of its points."""
    return material(part, (1.0, 1.0, 1.0), metallic=0.0, roughness=0.45)


def _listed(bones: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the bones' numbers, 0 where they do not count, as the format wants."""
    return np.where(weights > 0, bones, 0).astype(np.uint16)
