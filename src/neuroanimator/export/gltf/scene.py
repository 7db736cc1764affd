"""Clips as a GLB file: bones as nodes, their motion as an animation.

Inside, Z is up; glTF is Y up, so a root node turns each body (x, y, z) → (x, z, -y).
Quaternions are wxyz inside and xyzw in the file; colours are sRGB inside and linear in the file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.colour import linear_of
from neuroanimator.appearance.part_names import identifier, unique
from neuroanimator.appearance.skeleton import Bone, Shape
from neuroanimator.export.bodies import (
    GHOST,
    Paint,
    SceneBody,
    SkinNode,
    bodies_of,
)
from neuroanimator.export.gltf.buffers import Buffer, as_float32, glb_bytes
from neuroanimator.export.gltf.meshes import (
    inverse_bind_matrices,
    shape_primitive,
    skin_primitives,
    surface_primitive,
)
from neuroanimator.export.morphs import SurfaceNode
from neuroanimator.files.atomic import write_whole

Y_UP = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
"""Quaternion xyzw of a root node: a quarter turn about x, from Z up to Y up."""

XYZW = [1, 2, 3, 0]
"""Order of a quaternion's numbers in the file; inside it is wxyz."""

MIN_TRAVEL = 1e-9
"""Motion relative to its parent below which a bone gets no track of positions [m]."""

ELEMENTS = {"translation": "VEC3", "rotation": "VEC4", "weights": "SCALAR"}
"""The format's type of the values of each property that moves."""

QUANTISED = "KHR_mesh_quantization"
"""glTF extension by which morph targets are integers of one or two bytes."""

GHOST_PREFIX = "ghost "
"""Beginning of the names of a ghost's meshes."""

SURFACES = {"dry": (0.1, 0.6), "ghost": (0.0, 0.5), "wet": (0.0, 0.45)}
"""Metallic and roughness factors of surfaces: wet ones are smoother than dry ones."""


def write_glb(clips: Clip | Sequence[Clip], path: str | Path, *, ghost: Clip | None = None) -> None:
    """Write one clip, or several such as a school, to `path`: one node per bone, channels for what moves.

    Several bodies keep their own positions; only the first one's scenery is written. With several, node names begin with
    the clip's name and number. A skin is one more node of the scene, as only its bones move it. A `ghost` is another
    motion of the only clip's body at the same place and time, in one translucent colour, such as the emulator's beside
    the physics'. The `extras` of its root node describe each motion.
    """
    write_whole(Path(path), glb_content(clips, ghost))


def glb_content(clips: Clip | Sequence[Clip], ghost: Clip | None = None) -> bytes:
    """Return the bytes of the file of `write_glb`."""
    bodies = bodies_of(clips, ghost)
    scene = _Scene(bodies[0].clip.rate)
    for body in bodies:
        scene.add(body)
    return scene.content()


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
        self._materials: dict[tuple[tuple[float, ...] | str, bool], int] = {}
        self._names: set[str] = set()

    def add(self, body: SceneBody) -> None:
        """Add the moving parts of a body, and its scenery."""
        nodes = self.document["nodes"]
        root = len(nodes)
        self.document["scenes"][0]["nodes"].append(root)
        # Names of joints are identifiers, as engines want.
        named = self._own if body.skin is None else self._identifier
        name = named(f"{body.title} root")
        nodes.append({"name": name, "rotation": Y_UP, "extras": self._extras(body.clip)})
        for bone, positions, orientations, shapes in body.nodes:
            node: dict[str, Any] = {
                "name": named(body.prefix + bone.name),
                "translation": positions[0].tolist(),
                "rotation": orientations[0][XYZW].tolist(),
            }
            if shapes:
                node["mesh"] = self._mesh_of(body, bone, shapes)
            # The topmost bones have the parent -1.
            nodes[root + 1 + bone.parent].setdefault("children", []).append(len(nodes))
            nodes.append(node)
        times = self.buffer.add(as_float32(body.clip.times), "SCALAR", has_bounds=True)
        self._add_tracks(body, root, times)
        if body.surface is not None:
            self._add_surface(body, body.surface, root, times)
        if body.skin is not None:
            self._add_skin(body, body.skin, root)

    def content(self) -> bytes:
        """Return the bytes of the file."""
        self.document["buffers"] = [{"byteLength": len(self.buffer.content)}]
        # The format allows no empty lists.
        filled = {key: value for key, value in self.document.items() if value != []}
        return glb_bytes(filled, bytes(self.buffer.content))

    def _extras(self, clip: Clip) -> dict[str, Any]:
        """Return the description of a motion, with what `asset` says: some readers drop that one."""
        extras = {"system": clip.name, "seconds": round(float(clip.times[-1]), 6)}
        if clip.source:
            extras["source"] = clip.source
        return extras | self.document["asset"]["extras"]

    def _own(self, name: str) -> str:
        """Return `name`, numbered if another node has it."""
        own = unique(name, self._names)
        self._names.add(own)
        return own

    def _identifier(self, name: str) -> str:
        return identifier(name, self._names)

    def _mesh_of(self, body: SceneBody, bone: Bone, shapes: Sequence[tuple[Shape, Paint]]) -> int:
        """Return the mesh of a bone's shapes: the same for the same bone of another clip."""
        key = (bone.name, bone.shapes, body.is_ghost)
        if key not in self._meshes:
            primitives = [
                shape_primitive(shape, self.buffer) | {"material": self._material(paint)}
                for shape, paint in shapes
            ]
            self._meshes[key] = self._append_mesh(body, bone.name, primitives)
        return self._meshes[key]

    def _add_skin(self, body: SceneBody, skin: SkinNode, root: int) -> None:
        """Add a node with the skin of the bones after the node `root`."""
        key = (body.clip.skeleton.skin, skin.rest.tobytes(), body.is_ghost)
        if key not in self._meshes:
            primitives = []
            for paint, primitive in skin_primitives(skin, self.buffer).items():
                if body.is_ghost:
                    primitive["attributes"].pop("COLOR_0", None)
                shown = GHOST if body.is_ghost else paint
                primitives.append(primitive | {"material": self._material(shown)})
            self._meshes[key] = self._append_mesh(body, "skin", primitives)
        title = self._own(f"{body.prefix}skin")
        # Blender names the armature after the glTF skin. Unreal wants one bone above all others: the root.
        described = {
            "name": f"{body.prefix}bones",
            "joints": list(range(root, root + len(skin.rest))),
            "inverseBindMatrices": inverse_bind_matrices(skin, self.buffer),
            "skeleton": root,
        }
        bones = self._append("skins", described)
        node = self._append("nodes", {"name": title, "mesh": self._meshes[key], "skin": bones})
        self.document["scenes"][0]["nodes"].append(node)

    def _add_surface(self, body: SceneBody, surface: SurfaceNode, root: int, times: int) -> None:
        """Add a node with a surface below the node `root`, and the track of its targets at `times`."""
        morphs = surface.morphs
        key = (morphs, body.is_ghost)
        if key not in self._meshes:
            material = self._material(body.surface_paint)
            primitive = surface_primitive(morphs, not body.is_ghost, self.buffer)
            primitive |= {"material": material}
            names = [f"shape {number + 1}" for number in range(len(morphs.moving))]
            names += [f"normals {number + 1}" for number in range(len(morphs.turning))]
            extras = {"targetNames": names, "error": float(f"{morphs.error:.2g}")}
            self._meshes[key] = self._append_mesh(body, "surface", [primitive], extras=extras)
        node: dict[str, Any] = {
            "name": self._own(f"{body.prefix}surface"),
            "mesh": self._meshes[key],
            "translation": surface.positions[0].tolist(),
            "scale": [morphs.scale] * 3,
        }
        number = self._append("nodes", node)
        self.document["nodes"][root].setdefault("children", []).append(number)
        self._add_track(number, "translation", times, surface.positions)
        if surface.orientations is not None:
            node["rotation"] = as_float32(surface.orientations[0, XYZW]).tolist()
            self._add_track(number, "rotation", times, surface.orientations[:, XYZW])
        if surface.weights.size:
            node["weights"] = as_float32(surface.weights[0]).tolist()
            self._add_track(number, "weights", times, surface.weights.ravel())
            self.document["extensionsUsed"] = [QUANTISED]
            self.document["extensionsRequired"] = [QUANTISED]

    def _material(self, paint: Paint) -> int:
        """Return the material of `paint`; a new one gets a name of its own."""
        key = (paint.colour or paint.name, paint.is_thin)
        if key not in self._materials:
            taken = [known["name"] for known in self.document["materials"]]
            own = material(paint._replace(name=unique(paint.name, taken)))
            self._materials[key] = self._append("materials", own)
        return self._materials[key]

    def _append_mesh(
        self, body: SceneBody, name: str, primitives: list[dict[str, Any]], **others: object
    ) -> int:
        """Return the index of a mesh of the body, appended."""
        shown = GHOST_PREFIX + name if body.is_ghost else name
        return self._append("meshes", {"name": shown, "primitives": primitives} | others)

    def _append(self, group: str, described: dict[str, Any]) -> int:
        """Return the index of `described`, appended to the list `group` of the document."""
        self.document[group].append(described)
        return len(self.document[group]) - 1

    def _add_tracks(self, body: SceneBody, root: int, times: int) -> None:
        """Add the tracks at `times` of the bones that move, whose nodes come after the node `root`."""
        for index, node in enumerate(body.nodes, start=root + 1):
            if not node.bone.is_moving:
                continue
            self._add_track(index, "rotation", times, node.orientations[:, XYZW])
            if np.ptp(node.positions, axis=0).max() >= MIN_TRAVEL:
                self._add_track(index, "translation", times, node.positions)

    def _add_track(self, node: int, path: str, times: int, values: np.ndarray) -> None:
        """Let `path`, a property of `node`, have `values` at the accessor `times`."""
        output = self.buffer.add(as_float32(values), ELEMENTS[path])
        animation = self.document["animations"][0]
        sampler = len(animation["samplers"])
        target = {"node": node, "path": path}
        animation["channels"].append({"sampler": sampler, "target": target})
        animation["samplers"].append({"input": times, "output": output, "interpolation": "LINEAR"})


def material(paint: Paint) -> dict[str, Any]:
    """Return the glTF object of a material; where points have colours of their own it is white."""
    surface = "dry" if paint.colour else "wet"
    if paint.colour == GHOST.colour:
        surface = "ghost"
    *colour, opacity = paint.colour or (1.0, 1.0, 1.0, 1.0)
    light = [round(float(amount), 6) for amount in linear_of(colour)]
    metallic, roughness = SURFACES[surface]
    described: dict[str, Any] = {
        "name": paint.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*light, opacity],
            "metallicFactor": metallic,
            "roughnessFactor": roughness,
        },
    }
    if opacity < 1:
        described["alphaMode"] = "BLEND"
    if paint.is_thin:
        described["doubleSided"] = True
    return described
