"""Meshes of a GLB file: triangles of shapes, of a skin whose points follow the bones' nodes, and of surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Int

from neuroanimator.appearance.shape_mesh import shape_mesh
from neuroanimator.appearance.skeleton import Shape
from neuroanimator.export.bodies import Paint, SkinNode
from neuroanimator.export.gltf.buffers import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer, as_float32
from neuroanimator.export.morphs import Morphs

MAX_SHORT = 2**16 - 1
"""Number of a point that a two-byte index must not have: some viewers begin a new strip there."""


def shape_primitive(shape: Shape, buffer: Buffer) -> dict[str, Any]:
    """Return the triangles of `shape`, without a material."""
    mesh = shape_mesh(shape)
    points = as_float32(mesh.points)
    attributes = {
        "POSITION": buffer.add(points, "VEC3", target=ARRAY_BUFFER, has_bounds=True),
        "NORMAL": buffer.add(as_float32(mesh.normals), "VEC3", target=ARRAY_BUFFER),
    }
    return {"attributes": attributes, "indices": _indices(mesh.triangles, buffer)}


def skin_primitives(skin: SkinNode, buffer: Buffer) -> dict[Paint, dict[str, Any]]:
    """Return the triangles of each part of the skin without a material; the points are shared."""
    mesh = skin.mesh
    points = as_float32(mesh.points)
    attributes = {
        "POSITION": buffer.add(points, "VEC3", target=ARRAY_BUFFER, has_bounds=True),
        "NORMAL": buffer.add(as_float32(mesh.normals), "VEC3", target=ARRAY_BUFFER),
    }
    if any(paint.colour is None for paint in skin.parts):
        colours = as_float32(skin.colours)
        attributes["COLOR_0"] = buffer.add(colours, "VEC3", target=ARRAY_BUFFER)
    attributes |= {
        "JOINTS_0": buffer.add(skin.joints, "VEC4", target=ARRAY_BUFFER),
        "WEIGHTS_0": buffer.add(as_float32(mesh.weights), "VEC4", target=ARRAY_BUFFER),
    }
    primitives = {}
    for paint, part in skin.parts.items():
        indices = _indices(mesh.triangles[part], buffer)
        primitives[paint] = {"attributes": dict(attributes), "indices": indices}
    return primitives


def surface_primitive(morphs: Morphs, buffer: Buffer) -> dict[str, Any]:
    """Return the triangles of a surface and its morph targets, in units of its scale, without a material."""
    points = as_float32(morphs.points / morphs.scale)
    primitive: dict[str, Any] = {
        "attributes": {
            "POSITION": buffer.add(points, "VEC3", target=ARRAY_BUFFER, has_bounds=True),
            "NORMAL": buffer.add(as_float32(morphs.normals), "VEC3", target=ARRAY_BUFFER),
        },
        "indices": _indices(morphs.triangles, buffer),
    }
    # three.js wants every target to have the same attributes, Assimp wants numbers for each.
    none = np.zeros(points.shape, np.int8)
    pairs = [(target.whole, none) for target in morphs.moving]
    pairs += [(none, target.whole) for target in morphs.turning]
    targets = []
    for moves, turns in pairs:
        positions = buffer.add(moves, "VEC3", target=ARRAY_BUFFER, has_bounds=True)
        normals = buffer.add(turns, "VEC3", target=ARRAY_BUFFER, has_bounds=True)
        targets.append({"POSITION": positions, "NORMAL": normals})
    if targets:
        primitive["targets"] = targets
    return primitive


def inverse_bind_matrices(skin: SkinNode, buffer: Buffer) -> int:
    """Return the accessor of the matrices that transform points at rest into the frames of the joints."""
    matrices = np.tile(np.eye(4), (len(skin.rest), 1, 1))
    for matrix, rest in zip(matrices, skin.rest, strict=True):
        to_joint = rest[:3, :3].T
        matrix[:3, :3] = to_joint
        matrix[:3, 3] = -to_joint @ rest[:3, 3]
    return buffer.add(as_float32(matrices.transpose(0, 2, 1)), "MAT4")


def _indices(triangles: Int[np.ndarray, "M 3"], buffer: Buffer) -> int:
    kind = np.uint16 if triangles.max() < MAX_SHORT else np.uint32
    corners = triangles.astype(kind).ravel()
    return buffer.add(corners, "SCALAR", target=ELEMENT_ARRAY_BUFFER)
