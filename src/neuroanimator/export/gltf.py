"""A clip as a GLB file: bones as nodes, their turns as an animation.

Inside, Z is up; glTF is Y up, so one root node turns the scene (x, y, z) → (x, z, -y).
Quaternions are wxyz inside and xyzw in the file.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.animation.interpolate import continuous
from neuroanimator.errors import ArgumentError
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
GHOST_OPACITY = 0.35
"""The body behind stays clearly visible, and the ghost too where it is elsewhere."""
GHOST_PREFIX = "ghost "
"""Of the names of a ghost's nodes: engines find what moves by its name."""


def write_glb(clip: Clip, path: Path, *, ghost: Clip | None = None) -> None:
    """Write `clip` to `path`: one node per bone, one mesh per bone that has shapes, channels for what moves.

    A skin is one more node beside the scene's, for what moves it is its bones alone. A `ghost` is another motion of
    the same body, seen at the same place and time, translucent: such as the emulator's beside the physics'.
    """
    if ghost is not None and ghost.skeleton != clip.skeleton:
        raise ArgumentError(f"ghost: wanted another motion of the same body, came {ghost.name} beside {clip.name}.")
    buffer = Buffer()
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "NeuroAnimator"},
        "scene": 0,
        "scenes": [{"nodes": []}],
        "nodes": [],
        "meshes": [],
        "materials": [],
        "animations": [{"name": "motion", "samplers": [], "channels": []}],
        "skins": [],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    }
    _add_body(document, clip, buffer)
    if ghost is not None:
        _add_body(document, ghost, buffer, GHOST_PREFIX, GHOST_OPACITY)
    document["buffers"] = [{"byteLength": len(buffer.content)}]
    document = {key: value for key, value in document.items() if value != []}  # the format knows no empty lists
    write_whole(path, container(document, bytes(buffer.content)))


def _add_body(document: dict[str, Any], clip: Clip, buffer: Buffer, prefix: str = "", opacity: float = 1.0) -> None:
    root, first_mesh, first_material = (len(document[key]) for key in ("nodes", "meshes", "materials"))
    bones = clip.skeleton.bones
    palette = list(dict.fromkeys(shape.colour for bone in bones for shape in bone.shapes))
    places, turns = clip.skeleton.local_poses(clip.states)
    document["scenes"][0]["nodes"].append(root)
    document["nodes"] += _nodes(clip, prefix, places[0], turns[0], root, first_mesh)
    document["meshes"] += [_mesh(bone, prefix, palette, first_material, buffer) for bone in bones if bone.shapes]
    document["materials"] += [_material(colour, opacity) for colour in palette]
    _add_tracks(document["animations"][0], clip, places, continuous(turns), root, buffer)
    if clip.skeleton.skin is not None:
        _add_skin(document, clip.skeleton, f"{prefix}skin", root, opacity, buffer)


def _add_skin(
    document: dict[str, Any], skeleton: Skeleton, name: str, root: int, opacity: float, buffer: Buffer
) -> None:
    node, mesh, material, skin = (len(document[key]) for key in ("nodes", "meshes", "materials", "skins"))
    document["meshes"].append(skin_mesh_object(skeleton, name, material, buffer))
    document["materials"].append(skin_material(opacity))
    document["skins"].append(skin_object(skeleton, root, buffer))
    document["nodes"].append({"name": name, "mesh": mesh, "skin": skin})
    document["scenes"][0]["nodes"].append(node)


def _nodes(
    clip: Clip, prefix: str, places: np.ndarray, turns: np.ndarray, root: int, first_mesh: int
) -> list[dict[str, Any]]:
    """Return the node `root` and, after it, each bone in its pose at the first frame."""
    bones = clip.skeleton.bones
    children = lambda parent: [root + 1 + i for i, bone in enumerate(bones) if bone.parent == parent]  # noqa: E731
    nodes: list[dict[str, Any]] = [{"name": prefix + clip.name, "rotation": Y_UP, "children": children(-1)}]
    meshes = itertools.count(first_mesh)
    for i, bone in enumerate(bones):
        node = {"name": prefix + bone.name, "translation": places[i].tolist(), "rotation": turns[i][XYZW].tolist()}
        node |= {"mesh": next(meshes)} if bone.shapes else {}
        nodes.append(node | ({"children": children(i)} if children(i) else {}))
    return nodes


def _mesh(
    bone: Bone, prefix: str, palette: list[tuple[float, ...]], first_material: int, buffer: Buffer
) -> dict[str, Any]:
    primitives = []
    for shape in bone.shapes:
        mesh = shape_mesh(shape)
        attributes = {
            "POSITION": buffer.add(mesh.points, "VEC3", target=ARRAY_BUFFER, bounds=True),
            "NORMAL": buffer.add(mesh.normals, "VEC3", target=ARRAY_BUFFER),
        }
        indices = buffer.add(mesh.triangles.ravel(), "SCALAR", target=ELEMENT_ARRAY_BUFFER)
        material = first_material + palette.index(shape.colour)
        primitives.append({"attributes": attributes, "indices": indices, "material": material})
    return {"name": prefix + bone.name, "primitives": primitives}


def _material(colour: tuple[float, ...], opacity: float) -> dict[str, Any]:
    shown = [*colour[:3], colour[3] * opacity]
    surface = {"baseColorFactor": shown, "metallicFactor": 0.1, "roughnessFactor": 0.6}
    return {"pbrMetallicRoughness": surface} | ({"alphaMode": "BLEND"} if shown[3] < 1 else {})


def _add_tracks(
    animation: dict[str, Any], clip: Clip, places: np.ndarray, turns: np.ndarray, root: int, buffer: Buffer
) -> None:
    times = buffer.add(clip.times.astype(np.float32), "SCALAR", bounds=True)
    samplers, channels = animation["samplers"], animation["channels"]
    for i, bone in enumerate(clip.skeleton.bones):
        if not bone.is_moving:
            continue
        tracks = [("rotation", turns[:, i][:, XYZW], "VEC4"), ("translation", places[:, i], "VEC3")]
        for path, track, kind in tracks:
            if path == "translation" and np.ptp(track, axis=0).max() < SMALLEST_WAY:
                continue
            output = buffer.add(np.ascontiguousarray(track, dtype=np.float32), kind)
            channels.append({"sampler": len(samplers), "target": {"node": root + 1 + i, "path": path}})
            samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
