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
from neuroanimator.animation.interpolate import continuous
from neuroanimator.export.shapes import shape_mesh
from neuroanimator.files import write_whole
from neuroanimator.systems.skeleton import Bone

FLOAT, UNSIGNED_SHORT = 5126, 5123
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
Y_UP = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
"""xyzw: a quarter turn about x that takes Z up to Y up."""

XYZW = [1, 2, 3, 0]
"""Order of a quaternion's numbers in the file."""
SMALLEST_WAY = 1e-9
"""[m] A bone that moves less against its parent gets no track of its places."""


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
    """Write `clip` to `path`: one node per bone, one mesh per bone that has shapes, channels for what moves."""
    buffer = _Buffer()
    palette = list(dict.fromkeys(shape.colour for bone in clip.skeleton.bones for shape in bone.shapes))
    places, turns = clip.skeleton.local_poses(clip.states)
    document = {
        "asset": {"version": "2.0", "generator": "NeuroAnimator"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": _nodes(clip, places[0], turns[0]),
        "meshes": [_mesh(bone, palette, buffer) for bone in clip.skeleton.bones if bone.shapes],
        "materials": [_material(colour) for colour in palette],
        "animations": [_animation(clip, places, continuous(turns), buffer)],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    write_whole(path, _container(document, bytes(buffer.content)))


def _nodes(clip: Clip, places: np.ndarray, turns: np.ndarray) -> list[dict[str, Any]]:
    """Return the root (node 0) and each bone i as node i + 1, in its pose at the first frame."""
    bones = clip.skeleton.bones
    children = lambda parent: [i + 1 for i, bone in enumerate(bones) if bone.parent == parent]  # noqa: E731
    nodes: list[dict[str, Any]] = [{"name": clip.name, "rotation": Y_UP, "children": children(-1)}]
    meshes = iter(range(len(bones)))
    for i, bone in enumerate(bones):
        node = {"name": bone.name, "translation": places[i].tolist(), "rotation": turns[i][XYZW].tolist()}
        node |= {"mesh": next(meshes)} if bone.shapes else {}
        nodes.append(node | ({"children": children(i)} if children(i) else {}))
    return nodes


def _mesh(bone: Bone, palette: list[tuple[float, ...]], buffer: _Buffer) -> dict[str, Any]:
    primitives = []
    for shape in bone.shapes:
        mesh = shape_mesh(shape)
        attributes = {
            "POSITION": buffer.add(mesh.points, "VEC3", target=ARRAY_BUFFER, bounds=True),
            "NORMAL": buffer.add(mesh.normals, "VEC3", target=ARRAY_BUFFER),
        }
        indices = buffer.add(mesh.triangles.ravel(), "SCALAR", target=ELEMENT_ARRAY_BUFFER)
        primitives.append({"attributes": attributes, "indices": indices, "material": palette.index(shape.colour)})
    return {"name": bone.name, "primitives": primitives}


def _material(colour: tuple[float, ...]) -> dict[str, Any]:
    surface = {"baseColorFactor": list(colour), "metallicFactor": 0.1, "roughnessFactor": 0.6}
    return {"pbrMetallicRoughness": surface} | ({"alphaMode": "BLEND"} if colour[3] < 1 else {})


def _animation(clip: Clip, places: np.ndarray, turns: np.ndarray, buffer: _Buffer) -> dict[str, Any]:
    times = buffer.add(clip.times.astype(np.float32), "SCALAR", bounds=True)
    samplers, channels = [], []
    for i, bone in enumerate(clip.skeleton.bones):
        if not bone.joints:
            continue
        tracks = [("rotation", turns[:, i][:, XYZW], "VEC4"), ("translation", places[:, i], "VEC3")]
        for path, track, kind in tracks:
            if path == "translation" and np.ptp(track, axis=0).max() < SMALLEST_WAY:
                continue
            output = buffer.add(np.ascontiguousarray(track, dtype=np.float32), kind)
            channels.append({"sampler": len(samplers), "target": {"node": i + 1, "path": path}})
            samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
    return {"name": "motion", "samplers": samplers, "channels": channels}


def _container(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    words = [MAGIC, 2, 12 + 8 + len(text) + 8 + len(binary), len(text), JSON_CHUNK]
    head = np.array(words, "<u4").tobytes()
    return head + text + np.array([len(binary), BINARY_CHUNK], "<u4").tobytes() + binary
