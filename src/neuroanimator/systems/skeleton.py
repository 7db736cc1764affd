"""How a state looks: a tree of bodies with simple shapes. Needs no physics engine."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from neuroanimator.systems.rotation import multiply, rotate

Numbers = tuple[float, ...]

JOINT_KINDS = ("hinge", "slide", "ball", "free")
SHAPE_KINDS = ("capsule", "box", "sphere", "ellipsoid", "cylinder")


@dataclass(frozen=True)
class Joint:
    """What lets a body move against its parent."""

    kind: str
    """One of `JOINT_KINDS`."""
    entry: int
    """First state entry it reads: an angle [rad], a way [m], a quaternion, or a place and a quaternion."""
    axis: Numbers
    """Unit axis in the body's frame; of hinges and slides."""
    anchor: Numbers
    """Point in the body's frame it turns about [m]."""
    reference: float = 0.0
    """Value of the entry at which the body is where the tree puts it."""


@dataclass(frozen=True)
class Shape:
    """Something to draw, fixed to a body."""

    kind: str
    """One of `SHAPE_KINDS`."""
    size: Numbers
    """[m] Radius and half length along Z (capsule, cylinder), radius (sphere), half axes (box, ellipsoid)."""
    place: Numbers
    turn: Numbers
    """Quaternion wxyz in the body's frame."""
    colour: Numbers
    """Red, green, blue, opacity, each 0 to 1."""


@dataclass(frozen=True)
class Bone:
    """One body."""

    name: str
    parent: int
    """Index of the bone it hangs from; -1 for the world."""
    offset: Numbers
    """Its origin in the parent's frame [m], joints at their references."""
    turn: Numbers
    """Quaternion wxyz in the parent's frame, joints at their references."""
    joints: tuple[Joint, ...]
    shapes: tuple[Shape, ...]


@dataclass(frozen=True)
class Skeleton:
    """Bones in order, each after its parent."""

    bones: tuple[Bone, ...]

    def local_poses(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return places (T, B, 3) [m] and quaternions wxyz (T, B, 4), each in its parent's frame, for states (T, S)."""
        poses = [_local_pose(bone, states) for bone in self.bones]
        return np.stack([place for place, _ in poses], axis=1), np.stack([turn for _, turn in poses], axis=1)

    def world_poses(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return places (T, B, 3) [m] and quaternions wxyz (T, B, 4) in the world, for states (T, S)."""
        places, turns = self.local_poses(states)
        for i, bone in enumerate(self.bones):
            if bone.parent >= 0:
                above = turns[:, bone.parent]
                places[:, i] = places[:, bone.parent] + rotate(above, places[:, i])
                turns[:, i] = multiply(above, turns[:, i])
        return places, turns

    def to_json(self) -> list[dict[str, Any]]:
        """Return plain dictionaries, one per bone."""
        return [asdict(bone) for bone in self.bones]

    @classmethod
    def from_json(cls, rows: list[dict[str, Any]]) -> Skeleton:
        """Return the skeleton `to_json` wrote; ValueError names what is wrong with it."""
        bones = []
        for i, row in enumerate(rows):
            joints = tuple(_read(Joint, joint, JOINT_KINDS) for joint in row.get("joints", ()))
            shapes = tuple(_read(Shape, shape, SHAPE_KINDS) for shape in row.get("shapes", ()))
            bone = _read(Bone, row | {"joints": joints, "shapes": shapes})
            if not -1 <= bone.parent < i:
                raise ValueError(f"skeleton: bone '{str(bone.name)[:40]}' comes before its parent")
            bones.append(bone)
        return cls(tuple(bones))


def _read(kind: type, row: dict[str, Any], valid: tuple[str, ...] = ()) -> Any:
    if {*row} != {field.name for field in fields(kind)} or (valid and row["kind"] not in valid):
        raise ValueError(f"skeleton: a {kind.__name__.lower()} has other fields than expected")
    return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in row.items()})


def _local_pose(bone: Bone, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (places (T, 3), quaternions (T, 4)) of a bone in its parent's frame, joint after joint as MuJoCo does."""
    place = np.broadcast_to(np.array(bone.offset), (len(states), 3))
    turn = np.broadcast_to(np.array(bone.turn), (len(states), 4))
    for joint in bone.joints:
        value = states[:, joint.entry]
        if joint.kind == "free":
            place, turn = states[:, joint.entry : joint.entry + 3], _unit(states, joint.entry + 3)
        elif joint.kind == "slide":
            way = (value - joint.reference)[:, None] * np.array(joint.axis)
            place = place + rotate(turn, way)
        else:
            anchor = np.broadcast_to(np.array(joint.anchor), place.shape)
            fixed = place + rotate(turn, anchor)
            own = _unit(states, joint.entry) if joint.kind == "ball" else _about(joint.axis, value - joint.reference)
            turn = multiply(turn, own)
            place = fixed - rotate(turn, anchor)
    return place, turn


def _unit(states: np.ndarray, entry: int) -> np.ndarray:
    quaternion = states[:, entry : entry + 4]
    return quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)


def _about(axis: Numbers, angle: np.ndarray) -> np.ndarray:
    half = angle[:, None] / 2
    return np.concatenate([np.cos(half), np.sin(half) * np.array(axis)], axis=-1)
