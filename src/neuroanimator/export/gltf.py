"""A clip as a GLB file: bones as nodes, their turns as an animation.

Inside, Z is up; glTF is Y up, so one root node turns the scene (x, y, z) → (x, z, -y).
Quaternions are wxyz inside and xyzw in the file.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.animation.interpolate import continuous
from neuroanimator.export.glb import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer, container
from neuroanimator.export.shapes import shape_mesh
from neuroanimator.export.skin_gltf import skin_material, skin_mesh_object, skin_object
from neuroanimator.files import write_whole
from neuroanimator.systems.skeleton import Bone, Skeleton

Y_UP = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
"""xyzw: a quarter turn about x that takes Z up to Y up."""

XYZW = [1, 2, 3, 0]
"""Order of a quaternion's numbers in the file."""
SMALLEST_WAY = 1e-9
"""[m] A bone that moves less against its parent gets no track of its places."""


def write_glb(clip: Clip, path: Path) -> None:
    """Write `clip` to `path`: one node per bone, one mesh per bone that has shapes, channels for what moves.

    A skin is one more node beside the scene's, for what moves it is its bones alone.
    """
    buffer = Buffer()
    palette = list(dict.fromkeys(shape.colour for bone in clip.skeleton.bones for shape in bone.shapes))
    places, turns = clip.skeleton.local_poses(clip.states)
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "NeuroAnimator"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": _nodes(clip, places[0], turns[0]),
        "meshes": [_mesh(bone, palette, buffer) for bone in clip.skeleton.bones if bone.shapes],
        "materials": [_material(colour) for colour in palette],
        "animations": [_animation(clip, places, continuous(turns), buffer)],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    }
    if clip.skeleton.skin is not None:
        _add_skin(document, clip.skeleton, buffer)
    document["buffers"] = [{"byteLength": len(buffer.content)}]
    document = {key: value for key, value in document.items() if value != []}  # the format knows no empty lists
    write_whole(path, container(document, bytes(buffer.content)))


def _add_skin(document: dict[str, Any], skeleton: Skeleton, buffer: Buffer) -> None:
    mesh, material, node = len(document["meshes"]), len(document["materials"]), len(document["nodes"])
    document["meshes"].append(skin_mesh_object(skeleton, material, buffer))
    document["materials"].append(skin_material())
    document["skins"] = [skin_object(skeleton, 1, buffer)]
    document["nodes"].append({"name": "skin", "mesh": mesh, "skin": 0})
    document["scenes"][0]["nodes"].append(node)


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


def _mesh(bone: Bone, palette: list[tuple[float, ...]], buffer: Buffer) -> dict[str, Any]:
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


def _animation(clip: Clip, places: np.ndarray, turns: np.ndarray, buffer: Buffer) -> dict[str, Any]:
    times = buffer.add(clip.times.astype(np.float32), "SCALAR", bounds=True)
    samplers, channels = [], []
    for i, bone in enumerate(clip.skeleton.bones):
        if not bone.is_moving:
            continue
        tracks = [("rotation", turns[:, i][:, XYZW], "VEC4"), ("translation", places[:, i], "VEC3")]
        for path, track, kind in tracks:
            if path == "translation" and np.ptp(track, axis=0).max() < SMALLEST_WAY:
                continue
            output = buffer.add(np.ascontiguousarray(track, dtype=np.float32), kind)
            channels.append({"sampler": len(samplers), "target": {"node": i + 1, "path": path}})
            samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
    return {"name": "motion", "samplers": samplers, "channels": channels}
