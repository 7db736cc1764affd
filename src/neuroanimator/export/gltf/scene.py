"""Clips as a GLB file: bones as nodes, their motion as an animation.

Inside, Z is up; glTF is Y up, so a root node turns each body (x, y, z) → (x, z, -y).
Quaternions are wxyz inside and xyzw in the file; colours are sRGB inside and light in the file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip, together
from neuroanimator.animation.interpolate import continuous
from neuroanimator.appearance.part_names import colour_names, identifier, unique
from neuroanimator.appearance.shape_mesh import shape_mesh
from neuroanimator.appearance.skeleton import Bone, Skeleton
from neuroanimator.export.gltf.buffers import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    Buffer,
    as_float32,
    glb_bytes,
)
from neuroanimator.export.gltf.materials import ghost_material, material
from neuroanimator.export.gltf.skin import skin_material, skin_object, skin_primitives
from neuroanimator.storage.files import write_whole

Y_UP = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
"""The quaternion xyzw of a root node: a quarter turn about x that takes Z up to Y up."""

XYZW = [1, 2, 3, 0]
"""The order in the file of a quaternion's numbers, which are wxyz inside."""

MIN_TRAVEL = 1e-9
"""A bone that moves less than this against its parent gets no track of its positions [m]."""

GHOST_PREFIX = "ghost "
"""What the names of a ghost's nodes begin with: engines find what moves by its name."""


def write_glb(clips: Clip | Sequence[Clip], path: str | Path, *, ghost: Clip | None = None) -> None:
    """Write one clip, or several such as a school, to `path`: one node per bone, channels for what moves.

    Several bodies keep their own positions; the scenery is there once, that of the first. Names of nodes begin with the
    clip's name and number if there are several. A skin is one more node beside the scene's, for what moves it is its
    bones alone. A `ghost` is another motion of the only clip's body at the same place and time, in one translucent
    colour: such as the emulator's beside the physics'. What each motion is of is in the `extras` of its root node.
    """
    path = Path(path)
    every = together(clips, ghost)
    scene = _Scene(every[0].rate)
    for number, clip in enumerate(every):
        prefix = "" if len(every) == 1 else f"{clip.name} {number + 1} "
        scene.add(clip, prefix, has_scenery=number == 0)
    if ghost is not None:
        scene.add(ghost, GHOST_PREFIX, is_ghost=True)
    write_whole(path, scene.content())


class _Scene:
    """A glTF document that grows body by body."""

    def __init__(self, rate: float):
        self.buffer = Buffer()
        self.document: dict[str, Any] = {
            "asset": {
                "version": "2.0",
                "generator": f"NeuroAnimator {version('neuroanimator')}",
                "extras": {"units": "m", "rate": round(rate, 6)},
            },
            "scene": 0,
            "scenes": [{"name": "scene", "nodes": []}],
            "nodes": [],
            "meshes": [],
            "materials": [],
            "animations": [{"name": "motion", "samplers": [], "channels": []}],
            "skins": [],
            "bufferViews": self.buffer.views,
            "accessors": self.buffer.accessors,
        }
        self._meshes: dict[tuple[Any, ...], int] = {}
        self._materials: dict[tuple[Any, ...], int] = {}
        self._names: set[str] = set()
        self._colour_names: dict[tuple[float, ...], str] = {}

    def add(
        self, clip: Clip, prefix: str, *, has_scenery: bool = False, is_ghost: bool = False
    ) -> None:
        """Add what moves in `clip`, and its scenery if asked for; names of nodes begin with `prefix`."""
        nodes = self.document["nodes"]
        bones = clip.skeleton.bones
        root = len(nodes)
        self._colour_names = colour_names(clip.skeleton)
        positions, orientations = clip.skeleton.local_poses(clip.states)
        self.document["scenes"][0]["nodes"].append(root)
        title = f"{prefix}root" if prefix and not is_ghost else f"{prefix}{clip.name} root"
        names = self._names_of(clip.skeleton, title, prefix)
        nodes.append({"name": names[0], "rotation": Y_UP, "extras": _extras(clip)})
        for number, bone in enumerate(bones):
            node: dict[str, Any] = {
                "name": names[1 + number],
                "translation": positions[0, number].tolist(),
                "rotation": orientations[0, number][XYZW].tolist(),
            }
            if bone.shapes and (has_scenery or clip.skeleton.is_moved(number)):
                node["mesh"] = self._mesh_of(clip.skeleton, number, is_ghost)
            nodes.append(node)
        _add_children(nodes, root, bones)
        self._add_tracks(clip, positions, continuous(orientations), root)
        if clip.skeleton.skin is not None:
            self._add_skin(clip.skeleton, prefix, root, is_ghost)

    def content(self) -> bytes:
        """Return the bytes of the file."""
        self.document["buffers"] = [{"byteLength": len(self.buffer.content)}]
        # The format knows no empty lists.
        filled = {key: value for key, value in self.document.items() if value != []}
        return glb_bytes(filled, bytes(self.buffer.content))

    def _names_of(self, skeleton: Skeleton, title: str, prefix: str) -> list[str]:
        """Return the names of the root and the bones; those of joints are identifiers, as engines want them."""
        names = [title, *(prefix + bone.name for bone in skeleton.bones)]
        if skeleton.skin is None:
            return [self._own(name) for name in names]
        return [identifier(name, self._names) for name in names]

    def _own(self, name: str) -> str:
        """Return `name`, numbered if another node has it."""
        own = unique(name, self._names)
        self._names.add(own)
        return own

    def _mesh_of(self, skeleton: Skeleton, number: int, is_ghost: bool) -> int:
        """Return the mesh of a bone's shapes: the same for the same bone of another clip."""
        bone = skeleton.bones[number]
        key = (bone.name, bone.shapes, is_ghost)
        if key not in self._meshes:
            primitives = []
            for shape, primitive in zip(bone.shapes, _primitives(bone, self.buffer), strict=True):
                paint = self._ghost() if is_ghost else self._painted(shape.colour)
                primitives.append(primitive | {"material": paint})
            name = GHOST_PREFIX + bone.name if is_ghost else bone.name
            self._meshes[key] = self._append("meshes", {"name": name, "primitives": primitives})
        return self._meshes[key]

    def _add_skin(self, skeleton: Skeleton, prefix: str, root: int, is_ghost: bool) -> None:
        """Add a node with the skin of the bones after the node `root`."""
        key = ("skin", skeleton.skin, tuple(bone.offset for bone in skeleton.bones), is_ghost)
        if key not in self._meshes:
            primitives = []
            for part, primitive in skin_primitives(skeleton, self.buffer).items():
                if is_ghost:
                    primitives.append(_without_colours(primitive) | {"material": self._ghost()})
                else:
                    paint = self._material((part,), skin_material(part))
                    primitives.append(primitive | {"material": paint})
            name = GHOST_PREFIX + "skin" if is_ghost else "skin"
            self._meshes[key] = self._append("meshes", {"name": name, "primitives": primitives})
        title = self._own(f"{prefix}skin")
        # Blender calls the armature by the name of the glTF skin.
        bones = f"{prefix}bones"
        skin = self._append("skins", skin_object(skeleton, bones, root, self.buffer))
        node = self._append("nodes", {"name": title, "mesh": self._meshes[key], "skin": skin})
        self.document["scenes"][0]["nodes"].append(node)

    def _painted(self, colour: tuple[float, ...]) -> int:
        """Return the material of that colour of the shapes of the clip that is added."""
        return self._material(colour, material(self._colour_names[colour], colour))

    def _ghost(self) -> int:
        return self._material(("ghost",), ghost_material())

    def _material(self, key: tuple[Any, ...], described: dict[str, Any]) -> int:
        """Return the material known by `key`; a new one is `described`, its name made its own."""
        if key not in self._materials:
            taken = [known["name"] for known in self.document["materials"]]
            own = described | {"name": unique(described["name"], taken)}
            self._materials[key] = self._append("materials", own)
        return self._materials[key]

    def _append(self, group: str, described: dict[str, Any]) -> int:
        """Return the index of what is described, appended to that list of the document."""
        self.document[group].append(described)
        return len(self.document[group]) - 1

    def _add_tracks(
        self,
        clip: Clip,
        positions: Float[np.ndarray, "F B 3"],
        orientations: Float[np.ndarray, "F B 4"],
        root: int,
    ) -> None:
        """Add the tracks of the bones that move, whose nodes come after the node `root`."""
        times = self.buffer.add(as_float32(clip.times), "SCALAR", has_bounds=True)
        for number, bone in enumerate(clip.skeleton.bones):
            if not bone.is_moving:
                continue
            node = root + 1 + number
            rotations = as_float32(orientations[:, number][:, XYZW])
            self._add_track(node, "rotation", times, self.buffer.add(rotations, "VEC4"))
            if np.ptp(positions[:, number], axis=0).max() >= MIN_TRAVEL:
                translations = as_float32(positions[:, number])
                self._add_track(node, "translation", times, self.buffer.add(translations, "VEC3"))

    def _add_track(self, node: int, path: str, times: int, values: int) -> None:
        """Let `path`, a property of `node`, follow the accessor `values` at those `times`."""
        animation = self.document["animations"][0]
        sampler = len(animation["samplers"])
        target = {"node": node, "path": path}
        animation["channels"].append({"sampler": sampler, "target": target})
        animation["samplers"].append({"input": times, "output": values, "interpolation": "LINEAR"})


def _add_children(nodes: list[dict[str, Any]], root: int, bones: Sequence[Bone]) -> None:
    """Tell each node its children; bones come in order after the node `root`, which is the parent -1."""
    for parent in range(-1, len(bones)):
        children = [root + 1 + child for child, bone in enumerate(bones) if bone.parent == parent]
        if children:
            nodes[root + 1 + parent]["children"] = children


def _without_colours(primitive: dict[str, Any]) -> dict[str, Any]:
    """Return a skin's primitive without the colours of its points."""
    attributes = dict(primitive["attributes"])
    del attributes["COLOR_0"]
    return primitive | {"attributes": attributes}


def _extras(clip: Clip) -> dict[str, Any]:
    """Return what a motion is of, for whoever opens the file."""
    extras = {"system": clip.name, "seconds": round(float(clip.times[-1]), 6)}
    if clip.source:
        extras["source"] = clip.source
    return extras


def _primitives(bone: Bone, buffer: Buffer) -> list[dict[str, Any]]:
    """Return the triangles of each shape of `bone`, without materials."""
    primitives = []
    for shape in bone.shapes:
        mesh = shape_mesh(shape)
        points = as_float32(mesh.points)
        corners = mesh.triangles.astype(np.uint16).ravel()
        attributes = {
            "POSITION": buffer.add(points, "VEC3", target=ARRAY_BUFFER, has_bounds=True),
            "NORMAL": buffer.add(as_float32(mesh.normals), "VEC3", target=ARRAY_BUFFER),
        }
        indices = buffer.add(corners, "SCALAR", target=ELEMENT_ARRAY_BUFFER)
        primitives.append({"attributes": attributes, "indices": indices})
    return primitives
