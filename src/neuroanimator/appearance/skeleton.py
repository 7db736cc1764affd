"""How a state looks: a tree of bodies with simple shapes, or bones under a skin. Needs no physics engine."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from neuroanimator.appearance.binding import Binding, binding_from_json, bound_pose
from neuroanimator.appearance.skin import Skin, skin_from_json, skin_to_json
from neuroanimator.parsing.names import check_label
from neuroanimator.parsing.numbers import number, numbers, whole
from neuroanimator.state.rotation import multiply, rotate
from neuroanimator.text import quoted

Numbers = tuple[float, ...]

JOINT_KINDS = ("hinge", "slide", "ball", "free")
SHAPE_KINDS = ("capsule", "box", "sphere", "ellipsoid", "cylinder")
SHAPE_SIZES = {"capsule": 2, "box": 3, "sphere": 1, "ellipsoid": 3, "cylinder": 2}
"""How many sizes each kind of shape needs; MuJoCo gives every shape three."""
MAX_SIZES = 3
JOINT_SIZES = {"ball": 4, "free": 7}
"""State entries a joint reads, if more than one."""
MAX_BONES = 500
"""A skeleton may come from a stranger, and every bone is drawn; a model has at most as many bodies."""
MAX_PIECES = 5000
"""Most joints, and most shapes, of one bone: the world of a model may have many."""
MAX_ENTRIES = 10**9
"""State entries a joint may read up to, before the state's own size is known."""
MAX_DISTANCE = 1e6
"""[m] Largest place and size drawn."""
MAX_VALUE = 1e9
"""[rad or m] Of a joint at its reference."""
UNIT_TOLERANCE = 1e-3
"""How far a quaternion or an axis read from a file may be off the length of 1."""


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
    position: Numbers
    orientation: Numbers
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
    orientation: Numbers
    """Quaternion wxyz in the parent's frame, joints at their references."""
    joints: tuple[Joint, ...]
    shapes: tuple[Shape, ...]
    binding: Binding | None = None
    """Mass points it goes with, instead of joints; it then hangs from the world, `offset` and `orientation` are at rest."""

    @property
    def is_moving(self) -> bool:
        """Whether anything moves it against its parent."""
        return bool(self.joints) or self.binding is not None


@dataclass(frozen=True)
class Skeleton:
    """Bones in order, each after its parent."""

    bones: tuple[Bone, ...]
    skin: Skin | None = None
    """Drawn around all bones."""

    def is_moved(self, number: int) -> bool:
        """Return whether anything moves bone `number`, or one it hangs from; what nothing moves is scenery."""
        while number >= 0:
            if self.bones[number].is_moving:
                return True
            number = self.bones[number].parent
        return False

    def local_poses(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return places (T, B, 3) [m] and quaternions wxyz (T, B, 4), each in its parent's frame, for states (T, S)."""
        poses = [_local_pose(bone, states) for bone in self.bones]
        return np.stack([position for position, _ in poses], axis=1), np.stack(
            [orientation for _, orientation in poses], axis=1
        )

    def world_poses(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return places (T, B, 3) [m] and quaternions wxyz (T, B, 4) in the world, for states (T, S)."""
        positions, orientations = self.local_poses(states)
        for i, bone in enumerate(self.bones):
            if bone.parent >= 0:
                above = orientations[:, bone.parent]
                positions[:, i] = positions[:, bone.parent] + rotate(above, positions[:, i])
                orientations[:, i] = multiply(above, orientations[:, i])
        return positions, orientations

    def to_json(self) -> list[dict[str, Any]] | dict[str, Any]:
        """Return plain dictionaries, one per bone; under a skin, in a dictionary with it."""
        bones = [_bone_to_json(bone) for bone in self.bones]
        return bones if self.skin is None else {"bones": bones, "skin": skin_to_json(self.skin)}

    @classmethod
    def from_json(cls, described: Any, state_size: int | None = None) -> Skeleton:
        """Return the skeleton `to_json` wrote; ValueError names what is wrong with it.

        If `state_size` is given, no bone may read beyond that many state entries.
        """
        try:
            return _skeleton_from_json(described, state_size)
        except (TypeError, KeyError, AttributeError, OverflowError) as error:
            raise ValueError(f"skeleton: {type(error).__name__} {str(error)[:80]}") from error


def _skeleton_from_json(described: Any, state_size: int | None) -> Skeleton:
    described = described if isinstance(described, dict) else {"bones": described, "skin": None}
    if {*described} != {"bones", "skin"} or not isinstance(described["bones"], list):
        raise ValueError("skeleton: wanted bones and a skin")
    if len(described["bones"]) > MAX_BONES:
        raise ValueError(f"skeleton: {len(described['bones'])} bones; wanted at most {MAX_BONES}")
    bones = tuple(_bone_from_json(row, i) for i, row in enumerate(described["bones"]))
    last = max((entry for bone in bones for entry in _entries_read(bone)), default=0)
    if state_size is not None and last > state_size:
        raise ValueError(f"skeleton: reads {last} state entries of {state_size}")
    skin = None if described["skin"] is None else skin_from_json(described["skin"])
    if skin is not None and (
        any(bone.binding is None for bone in bones) or not skin.fits([b.offset for b in bones])
    ):
        raise ValueError("skeleton: a skin needs other bones, which follow mass points")
    return Skeleton(bones, skin)


def _bone_to_json(bone: Bone) -> dict[str, Any]:
    row = asdict(bone)
    binding = row.pop("binding")
    return row if binding is None else row | {"binding": binding.model_dump(mode="json")}


def _bone_from_json(row: Any, position: int) -> Bone:
    row = {"binding": None, **row} if isinstance(row, dict) else row
    _check_keys(row, Bone)
    name = check_label(row["name"], f"bone {position}")
    label = f"bone '{name}'"
    joints = tuple(_joint_from_json(joint, label) for joint in _pieces(row["joints"], label))
    shapes = tuple(_shape_from_json(shape, label) for shape in _pieces(row["shapes"], label))
    binding = None if row["binding"] is None else binding_from_json(row["binding"])
    parent = whole(row["parent"], f"{label}: parent", -1, position - 1)
    if binding is not None and (joints or parent >= 0):
        raise ValueError(f"{label} follows mass points and has joints or a parent")
    offset, orientation = _place(row["offset"], label), _unit_vector(row["orientation"], label, 4)
    return Bone(name, parent, offset, orientation, joints, shapes, binding)


def _joint_from_json(row: Any, label: str) -> Joint:
    _check_keys(row, Joint, JOINT_KINDS)
    return Joint(
        kind=row["kind"],
        entry=whole(row["entry"], f"{label}: entry", 0, MAX_ENTRIES),
        axis=_unit_vector(row["axis"], label, 3),
        anchor=_place(row["anchor"], label),
        reference=number(row["reference"], f"{label}: reference", -MAX_VALUE, MAX_VALUE),
    )


def _shape_from_json(row: Any, label: str) -> Shape:
    _check_keys(row, Shape, SHAPE_KINDS)
    size = numbers(row["size"], f"{label}: size", most=MAX_DISTANCE)
    colour = numbers(row["colour"], f"{label}: colour", 4, 1)
    if not SHAPE_SIZES[row["kind"]] <= len(size) <= MAX_SIZES:
        raise ValueError(f"{label}: a {row['kind']} with {len(size)} sizes")
    if min(size) < 0 or min(colour) < 0:
        raise ValueError(f"{label}: wanted sizes and colours of 0 or more")
    return Shape(
        row["kind"],
        size,
        _place(row["position"], label),
        _unit_vector(row["orientation"], label, 4),
        colour,
    )


def _place(value: Any, label: str) -> Numbers:
    return numbers(value, f"{label}: place", 3, MAX_DISTANCE)


def _unit_vector(value: Any, label: str, size: int) -> Numbers:
    """Return an axis, or a quaternion; a length of 0 would make poses NaN."""
    vector = numbers(value, f"{label}: axis or turn", size, 2.0)
    if abs(np.linalg.norm(vector) - 1) > UNIT_TOLERANCE:
        raise ValueError(
            f"{label}: wanted an axis or a turn of length 1, came {quoted(list(vector))}"
        )
    return vector


def _pieces(rows: Any, label: str) -> list[Any]:
    if not isinstance(rows, list) or len(rows) > MAX_PIECES:
        raise ValueError(f"{label}: wanted lists of at most {MAX_PIECES} joints and shapes")
    return rows


def _check_keys(row: Any, kind: type, valid: tuple[str, ...] = ()) -> None:
    """Refuse a row that has not the fields of `kind`."""
    if not isinstance(row, dict) or {*row} != {field.name for field in fields(kind)}:
        raise ValueError(f"skeleton: a {kind.__name__.lower()} has other fields than expected")
    if valid and row["kind"] not in valid:
        raise ValueError(
            f"skeleton: no {kind.__name__.lower()} of the kind {quoted(row['kind'])} is known"
        )


def _entries_read(bone: Bone) -> list[int]:
    """Return how many state entries there must be at least for each thing that moves `bone`."""
    ends = [joint.entry + JOINT_SIZES.get(joint.kind, 1) for joint in bone.joints]
    return ends if bone.binding is None else [*ends, bone.binding.last_entry + 1]


def _local_pose(bone: Bone, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (places (T, 3), quaternions (T, 4)) of a bone in its parent's frame, joint after joint as MuJoCo does."""
    if bone.binding is not None:
        return bound_pose(bone.binding, states)
    position = np.broadcast_to(np.array(bone.offset), (len(states), 3))
    orientation = np.broadcast_to(np.array(bone.orientation), (len(states), 4))
    for joint in bone.joints:
        value = states[:, joint.entry]
        if joint.kind == "free":
            position, orientation = (
                states[:, joint.entry : joint.entry + 3],
                _unit(states, joint.entry + 3),
            )
        elif joint.kind == "slide":
            way = (value - joint.reference)[:, None] * np.array(joint.axis)
            position = position + rotate(orientation, way)
        else:
            anchor = np.broadcast_to(np.array(joint.anchor), position.shape)
            fixed = position + rotate(orientation, anchor)
            own = (
                _unit(states, joint.entry)
                if joint.kind == "ball"
                else _about(joint.axis, value - joint.reference)
            )
            orientation = multiply(orientation, own)
            position = fixed - rotate(orientation, anchor)
    return position, orientation


def _unit(states: np.ndarray, entry: int) -> np.ndarray:
    quaternion = states[:, entry : entry + 4]
    return quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)


def _about(axis: Numbers, angle: np.ndarray) -> np.ndarray:
    half = angle[:, None] / 2
    return np.concatenate([np.cos(half), np.sin(half) * np.array(axis)], axis=-1)
