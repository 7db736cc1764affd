"""Meshes of a GLB file: triangles of shapes, of a skin whose points follow the bones' nodes, and of surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

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
    attributes = _attributes(mesh.points, mesh.normals, buffer)
    return {"attributes": attributes, "indices": _indices(mesh.triangles, buffer)}


def skin_primitives(skin: SkinNode, buffer: Buffer) -> dict[Paint, dict[str, Any]]:
    """Return the triangles of each part of the skin without a material; the points are shared."""
    mesh = skin.mesh
    attributes = _attributes(mesh.points, mesh.normals, buffer)
    if any(paint.colour is None for paint in skin.parts):
        attributes["COLOR_0"] = _colours(skin.colours, buffer)
    attributes |= {
        "JOINTS_0": buffer.add(skin.joints, "VEC4", target=ARRAY_BUFFER),
        "WEIGHTS_0": buffer.add(as_float32(mesh.weights), "VEC4", target=ARRAY_BUFFER),
    }
    return {
        paint: {"attributes": dict(attributes), "indices": _indices(mesh.triangles[part], buffer)}
        for paint, part in skin.parts.items()
    }


def surface_primitive(morphs: Morphs, is_coloured: bool, buffer: Buffer) -> dict[str, Any]:
    """Return the triangles of a surface and its morph targets, in units of its scale, without a material."""
    primitive: dict[str, Any] = {
        "attributes": _attributes(morphs.points / morphs.scale, morphs.normals, buffer),
        "indices": _indices(morphs.triangles, buffer),
    }
    if is_coloured and morphs.colours is not None:
        primitive["attributes"]["COLOR_0"] = _colours(morphs.colours, buffer)
    # three.js wants every target to have the same attributes, Assimp wants numbers for each.
    none = np.zeros(morphs.points.shape, np.int8)
    pairs = [(target.whole, none) for target in morphs.moving]
    pairs += [(none, target.whole) for target in morphs.turning]
    if pairs:
        primitive["targets"] = [_attributes(*pair, buffer) for pair in pairs]
    return primitive


def _colours(colours: Float[np.ndarray, "V 3"], buffer: Buffer) -> int:
    """Return the accessor of the linear colours of points."""
    return buffer.add(as_float32(colours), "VEC3", target=ARRAY_BUFFER)


def inverse_bind_matrices(skin: SkinNode, buffer: Buffer) -> int:
    """Return the accessor of the matrices that transform points at rest into the frames of the joints."""
    matrices = np.linalg.inv(skin.rest)
    return buffer.add(as_float32(matrices.transpose(0, 2, 1)), "MAT4")


def _attributes(points: np.ndarray, normals: np.ndarray, buffer: Buffer) -> dict[str, int]:
    """Return the accessors of points and normals, or of their changes in whole numbers."""
    is_change = points.dtype.kind == "i"
    if not is_change:
        points, normals = as_float32(points), as_float32(normals)
    return {
        "POSITION": buffer.add(points, "VEC3", target=ARRAY_BUFFER, has_bounds=True),
        "NORMAL": buffer.add(normals, "VEC3", target=ARRAY_BUFFER, has_bounds=is_change),
    }


def _indices(triangles: Int[np.ndarray, "M 3"], buffer: Buffer) -> int:
    kind = np.uint16 if triangles.max() < MAX_SHORT else np.uint32
    corners = triangles.astype(kind).ravel()
    return buffer.add(corners, "SCALAR", target=ELEMENT_ARRAY_BUFFER)
