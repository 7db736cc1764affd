"""Meshes of a GLB file: triangles of shapes, and of a skin whose points follow the bones' nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Int

from neuroanimator.appearance.shape_mesh import shape_mesh
from neuroanimator.appearance.skeleton import Shape
from neuroanimator.export.bodies import SkinNode
from neuroanimator.export.gltf.buffers import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer, as_float32


def shape_primitive(shape: Shape, buffer: Buffer) -> dict[str, Any]:
    """Return the triangles of `shape`, without a material."""
    mesh = shape_mesh(shape)
    points = as_float32(mesh.points)
    attributes = {
        "POSITION": buffer.add(points, "VEC3", target=ARRAY_BUFFER, has_bounds=True),
        "NORMAL": buffer.add(as_float32(mesh.normals), "VEC3", target=ARRAY_BUFFER),
    }
    return {"attributes": attributes, "indices": _indices(mesh.triangles, buffer)}


def skin_primitives(skin: SkinNode, buffer: Buffer) -> dict[str, dict[str, Any]]:
    """Return, for each part of the skin, its triangles without a material: the points are shared."""
    mesh = skin.mesh
    colours = as_float32(skin.colours)
    points = as_float32(mesh.points)
    attributes = {
        "POSITION": buffer.add(points, "VEC3", target=ARRAY_BUFFER, has_bounds=True),
        "NORMAL": buffer.add(as_float32(mesh.normals), "VEC3", target=ARRAY_BUFFER),
        "COLOR_0": buffer.add(colours, "VEC3", target=ARRAY_BUFFER),
        "JOINTS_0": buffer.add(skin.joints, "VEC4", target=ARRAY_BUFFER),
        "WEIGHTS_0": buffer.add(as_float32(mesh.weights), "VEC4", target=ARRAY_BUFFER),
    }
    primitives = {}
    for name, part in skin.parts.items():
        indices = _indices(mesh.triangles[part], buffer)
        primitives[name] = {"attributes": attributes, "indices": indices}
    return primitives


def inverse_bind_matrices(skin: SkinNode, buffer: Buffer) -> int:
    """Return the accessor of the matrices that take points at rest into the frames of the joints."""
    matrices = np.tile(np.eye(4), (len(skin.rest), 1, 1))
    for matrix, rest in zip(matrices, skin.rest, strict=True):
        to_joint = rest[:3, :3].T
        matrix[:3, :3] = to_joint
        matrix[:3, 3] = -to_joint @ rest[:3, 3]
    return buffer.add(as_float32(matrices.transpose(0, 2, 1)), "MAT4")


def _indices(triangles: Int[np.ndarray, "M 3"], buffer: Buffer) -> int:
    corners = triangles.astype(np.uint16).ravel()
    return buffer.add(corners, "SCALAR", target=ELEMENT_ARRAY_BUFFER)
