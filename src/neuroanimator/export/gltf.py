"""A clip as a GLB file: bones as nodes, their turns as an animation.

Inside, Z is up; glTF is Y up, so one root node turns the scene (x, y, z) → (x, z, -y).
Quaternions are wxyz inside and xyzw in the file.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.export.capsule import capsule_mesh
from neuroanimator.files import write_whole

FLOAT, UNSIGNED_SHORT = 5126, 5123
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
Y_UP = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
"""xyzw: a quarter turn about x that takes Z up to Y up."""


class _Buffer:
    """The binary chunk and the glTF objects that point into it."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, array: np.ndarray, kind: str, *, target: int | None = None, bounds: bool = False) -> int:
        """Append `array` and return the index of its accessor."""
        component = FLOAT if array.dtype == np.float32 else UNSIGNED_SHORT
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": array.nbytes}
        self.views.append(view | ({"target": target} if target else {}))
        self.content += array.tobytes() + b"\0" * (-array.nbytes % 4)
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": component,
            "count": len(array),
            "type": kind,
        }
        if bounds:
            flat = array.reshape(len(array), -1)
            accessor |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_glb(clip: Clip, path: Path) -> None:
    """Write `clip` to `path`: one node and one mesh per bone, one rotation channel each."""
    buffer = _Buffer()
    meshes, materials = _draw_bones(clip, buffer)
    document = {
        "asset": {"version": "2.0", "generator": "NeuroAnimator"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": _nodes(clip),
        "meshes": meshes,
        "materials": materials,
        "animations": [_animation(clip, buffer)],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    write_whole(path, _container(document, bytes(buffer.content)))


def _nodes(clip: Clip) -> list[dict[str, Any]]:
    """Return the root (node 0) and each bone i as node i + 1."""
    bones = clip.skeleton.bones
    children = lambda parent: [i + 1 for i, bone in enumerate(bones) if bone.parent == parent]  # noqa: E731
    nodes: list[dict[str, Any]] = [{"name": clip.name, "rotation": Y_UP, "children": children(-1)}]
    for i, bone in enumerate(bones):
        node = {"name": bone.name, "mesh": i, "translation": list(bone.offset)}
        nodes.append(node | ({"children": children(i)} if children(i) else {}))
    return nodes


def _draw_bones(clip: Clip, buffer: _Buffer) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    meshes, materials = [], []
    for i, bone in enumerate(clip.skeleton.bones):
        points, normals, triangles = capsule_mesh(np.array(bone.start), np.array(bone.end), bone.radius)
        primitive = {
            "attributes": {
                "POSITION": buffer.add(points, "VEC3", target=ARRAY_BUFFER, bounds=True),
                "NORMAL": buffer.add(normals, "VEC3", target=ARRAY_BUFFER),
            },
            "indices": buffer.add(triangles.ravel(), "SCALAR", target=ELEMENT_ARRAY_BUFFER),
            "material": i,
        }
        meshes.append({"name": bone.name, "primitives": [primitive]})
        surface = {"baseColorFactor": list(bone.colour), "metallicFactor": 0.1, "roughnessFactor": 0.6}
        materials.append({"name": bone.name, "pbrMetallicRoughness": surface})
    return meshes, materials


def _animation(clip: Clip, buffer: _Buffer) -> dict[str, Any]:
    times = buffer.add(clip.times.astype(np.float32), "SCALAR", bounds=True)
    samplers, channels = [], []
    turns = continuous(clip.skeleton.local_rotations(clip.states))[..., [1, 2, 3, 0]]
    for i in range(len(clip.skeleton.bones)):
        output = buffer.add(np.ascontiguousarray(turns[:, i], dtype=np.float32), "VEC4")
        samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
        channels.append({"sampler": i, "target": {"node": i + 1, "path": "rotation"}})
    return {"name": "motion", "samplers": samplers, "channels": channels}


def continuous(quaternions: np.ndarray) -> np.ndarray:
    """Return quaternions (T, ..., 4) with signs flipped so that each is nearest to the one before."""
    dots = (quaternions[1:] * quaternions[:-1]).sum(axis=-1, keepdims=True)
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.concatenate([quaternions[:1], quaternions[1:] * signs])


def _container(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    words = [MAGIC, 2, 12 + 8 + len(text) + 8 + len(binary), len(text), JSON_CHUNK]
    head = np.array(words, "<u4").tobytes()
    return head + text + np.array([len(binary), BINARY_CHUNK], "<u4").tobytes() + binary
