"""The nodes of a GLB file as its skins are bound to them, and the points of its surface that each of them moves.

glTF is Y up; what is told of bones is Z up, as everywhere in the package: (x, y, z) → (x, -z, y).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.files.glb import Glb, object_at, objects_in
from neuroanimator.files.numbers import entries, numbers, whole
from neuroanimator.state.rotation import quaternions_of, rotation_matrices

MAX_DEPTH = 1000
"""Maximum number of nodes above a node."""

MAX_JOINTS = 1000
"""Maximum number of joints of a skin, and of nodes that have meshes."""

MAX_POINTS = 2_000_000
"""Maximum number of points of all meshes together."""

MAX_VALUE = 1e6
"""Largest coordinate, scale or time accepted."""

WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
"""Numbers per value of each property that can be animated, by its name in the format."""

AT_REST = {
    "translation": (0.0, 0.0, 0.0),
    "rotation": (0.0, 0.0, 0.0, 1.0),
    "scale": (1.0, 1.0, 1.0),
}
"""Default properties of a node."""

MAX_LENGTH_ERROR = 0.05
"""Maximum deviation of a quaternion's length from 1: files round."""

Matrix = Float[np.ndarray, "4 4"]
"""A transform of points, as a matrix that multiplies them with a 1 appended."""


class Skin(NamedTuple):
    """A surface that bends with its joints."""

    joints: list[int]
    """Numbers of their nodes."""
    backs: Float[np.ndarray, "J 4 4"]
    """Matrices from the surface to the joints' own axes."""
    into_world: Matrix
    """From the surface to the world."""


class RigBone(NamedTuple):
    """A node that moves points of the surface."""

    name: str
    above: str
    """Name of the node above it; empty if there is none."""
    position: Float[np.ndarray, " 3"]
    """Its place in the world [m]."""
    points: Float[np.ndarray, "P 3"]
    """The points of the surface that move most with it [m]."""


class Rig:
    """The nodes of a file. Its methods raise ValueError with what is wrong with the file."""

    def __init__(self, file: Glb):
        self.file = file
        self.nodes = file.objects("nodes")
        self._parents: dict[int, int] = {}
        for parent, node in enumerate(self.nodes):
            for child in entries(node.get("children", []), "children", len(self.nodes)):
                if child in self._parents:
                    raise ValueError(f"node {child} has two parents")
                self._parents[child] = parent
        self._standing: dict[int, Matrix] = {}

    def chain(self, number: int) -> list[int]:
        """Return the numbers of a node, its parent, and so on up."""
        chain = [number]
        while chain[-1] in self._parents:
            chain.append(self._parents[chain[-1]])
            if len(chain) > MAX_DEPTH:
                raise ValueError(
                    f"more than {MAX_DEPTH} nodes above a node, or a node above itself"
                )
        return chain

    def standing(self, number: int) -> Matrix:
        """Return the matrix from a node's own axes to the world's, without the animation."""
        for node in reversed(self.chain(number)):
            if node not in self._standing:
                own = properties_of(self.nodes[node], node)
                matrix = np.eye(4)
                rotation = rotation_matrices(np.roll(own["rotation"], 1))
                matrix[:3] = np.column_stack([rotation * own["scale"], own["translation"]])
                above = self._standing[self._parents[node]] if node in self._parents else np.eye(4)
                self._standing[node] = above @ matrix
        return self._standing[number]

    def bound(self, number: int) -> Matrix:
        """Return the matrix from a node's own axes to the world's in the pose to which its skin is bound.

        Many exporters leave the nodes in the first pose of the animation. The matrices of a skin tell how its joints lie
        to each other; the topmost of them lies as its node does.
        """
        for skin in self.skins:
            if number in skin.joints:
                return skin.into_world @ np.linalg.inv(skin.backs[skin.joints.index(number)])
        return self.standing(number)

    @cached_property
    def skins(self) -> list[Skin]:
        """The skins."""
        skins = []
        for described in self.file.objects("skins"):
            joints = list(entries(described.get("joints"), "joints", len(self.nodes)))
            backs = np.tile(np.eye(4), (len(joints), 1, 1))
            if "inverseBindMatrices" in described:
                matrices = self.file.array(described["inverseBindMatrices"], "MAT4")
                backs = matrices.reshape(-1, 4, 4).mT
            if not 0 < len(joints) == len(backs) <= MAX_JOINTS:
                raise ValueError(
                    f"a skin of {len(joints)} joints with {len(backs)} matrices; wanted as many, at most {MAX_JOINTS:,}"
                )
            for back in backs:
                taken_apart(back, "a skin")
            top = [node for node in self.chain(joints[0]) if node in joints][-1]
            into_world = self.standing(top) @ backs[joints.index(top)]
            skins.append(Skin(joints, backs, into_world))
        return skins

    def bones(self) -> list[RigBone]:
        """Return the joints that move most of some points; without a skin, the nodes that have meshes and are animated."""
        points: dict[int, list[np.ndarray]] = {}
        count = 0
        for number, attributes in self._surfaces():
            places = self.file.array(attributes.get("POSITION"), "VEC3")
            count += len(places)
            if count > MAX_POINTS:
                raise ValueError(f"more than {MAX_POINTS:,} points. Leave meshes out")
            owners = np.full(len(places), number)
            matrix = self.standing(number)
            if self.skins:
                skin = self.skins[
                    whole(self.nodes[number]["skin"], "number of a skin", 0, len(self.skins) - 1)
                ]
                matrix = skin.into_world
                joints = self.file.array(attributes.get("JOINTS_0"), "VEC4", is_index=True)
                weights = self.file.array(attributes.get("WEIGHTS_0"), "VEC4")
                if not len(joints) == len(weights) == len(places):
                    raise ValueError("a skin with other numbers of points, joints and weights")
                strongest = weights.argmax(axis=1, keepdims=True)
                chosen = np.take_along_axis(joints, strongest, axis=1)[:, 0].astype(int)
                if not 0 <= chosen.min() <= chosen.max() < len(skin.joints):
                    raise ValueError(f"a point moved by joint {chosen.max()} of {len(skin.joints)}")
                owners = np.array(skin.joints)[chosen]
            placed = z_up(places @ matrix[:3, :3].T + matrix[:3, 3])
            for owner in np.unique(owners).tolist():
                points.setdefault(owner, []).append(placed[owners == owner])
        return [
            RigBone(
                self._name(number),
                self._name(self._parents.get(number)),
                z_up(self.bound(number)[None, :3, 3])[0],
                np.concatenate(parts),
            )
            for number, parts in sorted(points.items())
        ]

    def _name(self, number: int | None) -> str:
        return "" if number is None else str(self.nodes[number].get("name", ""))

    def _surfaces(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield (number of the node, attributes) of each surface that moves; those that share their points once."""
        moving = set()
        for animation in self.file.objects("animations"):
            for channel in objects_in(animation, "channels"):
                target = channel.get("target")
                node = target.get("node") if isinstance(target, dict) else None
                moving.add(node if isinstance(node, int) else None)
        meshes = self.file.objects("meshes")
        seen = set()
        with_mesh = [number for number, node in enumerate(self.nodes) if "mesh" in node]
        if len(with_mesh) > MAX_JOINTS:
            raise ValueError(f"more than {MAX_JOINTS:,} nodes with meshes. Join them")
        for number in with_mesh:
            node = self.nodes[number]
            is_shown = "skin" in node if self.skins else moving.intersection(self.chain(number))
            if not is_shown:
                continue
            for primitive in objects_in(object_at(meshes, node["mesh"], "mesh"), "primitives"):
                attributes = primitive.get("attributes")
                if not isinstance(attributes, dict):
                    raise ValueError("a mesh without attributes")
                key = (number, repr(attributes.get("POSITION")))
                if key not in seen:
                    seen.add(key)
                    yield number, attributes


def properties_of(node: dict[str, Any], number: int) -> dict[str, np.ndarray]:
    """Return translation, rotation xyzw and scale of a node without its animation; ValueError for impossible ones."""
    what = f"node {number}"
    found = {}
    for name, usual in AT_REST.items():
        given = numbers(node.get(name, usual), f"{what}: {name}", WIDTHS[name], MAX_VALUE)
        found[name] = np.array(given)
    if "matrix" in node:
        columns = np.array(numbers(node["matrix"], f"{what}: matrix", 16, MAX_VALUE))
        found = taken_apart(columns.reshape(4, 4).T, what)
    length = np.linalg.norm(found["rotation"])
    if abs(length - 1) > MAX_LENGTH_ERROR:
        raise ValueError(f"{what}: rotation: a quaternion that is not of length 1")
    found["rotation"] = found["rotation"] / length
    return found


def taken_apart(matrix: Matrix, what: str) -> dict[str, np.ndarray]:
    """Return translation, rotation xyzw and scale of a matrix; ValueError if it is made of anything else."""
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    if scale.min() == 0 or np.linalg.det(matrix[:3, :3]) <= 0:
        raise ValueError(f"{what}: a matrix that is not a rotation and a scale")
    rotation = np.roll(quaternions_of(matrix[:3, :3] / scale), -1)
    return {"translation": matrix[:3, 3], "rotation": rotation, "scale": scale}


def z_up(vectors: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Return vectors along the axes of glTF along those of the package."""
    x, y, z = vectors.T
    return np.stack([x, -z, y], axis=1)
