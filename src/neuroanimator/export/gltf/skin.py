"""A skin in a GLB file: one mesh whose points follow the bones' nodes, a primitive for each of its parts."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt16

from neuroanimator.appearance.colour import linear_of
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin_mesh import PARTS, colours_of, part_numbers, skin_mesh
from neuroanimator.export.gltf.buffers import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer, as_float32
from neuroanimator.export.gltf.materials import material
from neuroanimator.state.rotation import rotation_matrices

METALLIC = 0.0
"""How metallic a skin is: not at all."""

ROUGHNESS = 0.45
"""How rough a skin is: less than dry things, since it is wet."""


def skin_primitives(skeleton: Skeleton, buffer: Buffer) -> dict[str, dict[str, Any]]:
    """Return, for each part of the skin there is, its primitive without a material: the points are shared."""
    assert skeleton.skin is not None
    mesh = skin_mesh(skeleton)
    colours = as_float32(linear_of(colours_of(skeleton.skin, mesh.shades)))
    points = as_float32(mesh.points)
    joints = _joints(mesh.bones, mesh.weights)
    attributes = {
        "POSITION": buffer.add(points, "VEC3", target=ARRAY_BUFFER, has_bounds=True),
        "NORMAL": buffer.add(as_float32(mesh.normals), "VEC3", target=ARRAY_BUFFER),
        "COLOR_0": buffer.add(colours, "VEC3", target=ARRAY_BUFFER),
        "JOINTS_0": buffer.add(joints, "VEC4", target=ARRAY_BUFFER),
        "WEIGHTS_0": buffer.add(as_float32(mesh.weights), "VEC4", target=ARRAY_BUFFER),
    }
    part_of = part_numbers(skeleton.skin, mesh)
    primitives = {}
    for number, name in enumerate(PARTS):
        triangles = mesh.triangles[part_of == number]
        if len(triangles):
            corners = triangles.astype(np.uint16).ravel()
            indices = buffer.add(corners, "SCALAR", target=ELEMENT_ARRAY_BUFFER)
            primitives[name] = {"attributes": attributes, "indices": indices}
    return primitives


def skin_object(skeleton: Skeleton, name: str, root: int, buffer: Buffer) -> dict[str, Any]:
    """Return the glTF object of a skin: bones as joints, and what takes points at rest into their frames.

    The joints are the node `root`, which no point follows, and those after it: Unreal wants one bone above all others.
    """
    matrices = np.zeros((1 + len(skeleton.bones), 4, 4))
    matrices[0] = np.eye(4)
    for matrix, bone in zip(matrices[1:], skeleton.bones, strict=True):
        to_bone = rotation_matrices(np.array(bone.orientation)).T
        matrix[:3, :3] = to_bone
        matrix[:3, 3] = -to_bone @ np.array(bone.offset)
        matrix[3, 3] = 1
    columns = as_float32(matrices.transpose(0, 2, 1))
    joints = list(range(root, root + 1 + len(skeleton.bones)))
    return {
        "name": name,
        "joints": joints,
        "inverseBindMatrices": buffer.add(columns, "MAT4"),
        "skeleton": root,
    }


def skin_material(part: str) -> dict[str, Any]:
    """Return the glTF object of a wet surface; its colour is that of its points."""
    return material(part, (1.0, 1.0, 1.0), metallic=METALLIC, roughness=ROUGHNESS)


def _joints(
    bones: Int[np.ndarray, "N 4"], weights: Float[np.ndarray, "N 4"]
) -> UInt16[np.ndarray, "N 4"]:
    """Return the numbers of the bones' joints after the root's, 0 where they do not count, as the format wants."""
    return np.where(weights > 0, bones + 1, 0).astype(np.uint16)
