"""The skeleton of a state: a tree of bones with joints and simple shapes, or bones under a skin; and its JSON.

Needs no physics engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.binding import Binding, Pose, binding_from_json, bound_pose
from neuroanimator.appearance.mesh_skin import MeshSkin
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skin import Skin, skin_from_json, skin_to_json
from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_label
from neuroanimator.files.numbers import number, numbers, whole
from neuroanimator.state.kinematics import Kinematics
from neuroanimator.state.links import JOINT_KINDS, JOINT_SIZES, Joint, Link, Numbers
from neuroanimator.state.rotation import multiply, rotate
from neuroanimator.text import did_you_mean, quoted

Poses = tuple[Float[np.ndarray, "T B 3"], Float[np.ndarray, "T B 4"]]
"""Positions [m] and orientations wxyz of B bones in T states."""

SHAPE_SIZES = {"capsule": 2, "box": 3, "sphere": 1, "ellipsoid": 3, "cylinder": 2}
"""Number of sizes of each kind of shape."""

SHAPE_KINDS = tuple(SHAPE_SIZES)
"""Kinds of shapes, as MuJoCo calls them."""

MAX_SIZES = 3
"""Maximum number of sizes of a shape: MuJoCo gives every shape three."""

MAX_BONES = 500
"""Maximum number of bones, and of bodies of a model: a skeleton may come from a stranger, and every bone is drawn."""

MAX_PIECES = 5000
"""Maximum number of joints, and of shapes, of one bone: the world of a model may have many."""

MAX_ENTRIES = 10**9
"""Largest state entry a joint may read before the state's size is known."""

MAX_DISTANCE = 1e6
"""Largest position and size drawn [m]."""

MAX_VALUE = 1e9
"""Largest value of a joint at its reference [rad or m]."""

UNIT_TOLERANCE = 1e-3
"""Tolerance of the length of a quaternion or an axis read from a file, which should be 1."""

MAX_COMPONENT = 2.0
"""Largest component an axis or a quaternion may have before its length is checked."""

MAX_REASON = 80
"""Maximum number of characters of Python's own reason that a message quotes."""


@dataclass(frozen=True)
class Shape:
    """Something to draw, fixed to a bone."""

    kind: str
    """One of `SHAPE_KINDS`."""
    size: Numbers
    """Radius and half length along Z (capsule, cylinder), radius (sphere), half axes (box, ellipsoid) [m]."""
    position: Numbers
    """Its middle in the bone's frame [m]."""
    orientation: Numbers
    """Quaternion wxyz in the bone's frame."""
    colour: Numbers
    """Red, green, blue, opacity, each 0 to 1."""


@dataclass(frozen=True)
class Bone:
    """One rigid part: its parent, the joints that move it, and its shapes."""

    name: str
    parent: int
    """Index of its parent bone; -1 for the world."""
    offset: Numbers
    """Its origin in the parent's frame [m], joints at their references."""
    orientation: Numbers
    """Quaternion wxyz in the parent's frame, joints at their references."""
    joints: tuple[Joint, ...]
    shapes: tuple[Shape, ...]
    binding: Binding | None = None
    """Mass points it follows, instead of joints; its parent is then the world.

    Its `offset` and `orientation` are those at rest.
    """

    @property
    def link(self) -> Link:
        """The link of this bone: its parent and joint, without its shapes."""
        return Link(self.offset, self.orientation, self.joints)

    @property
    def is_moving(self) -> bool:
        """Whether anything moves it relative to its parent."""
        return bool(self.joints) or self.binding is not None


@dataclass(frozen=True)
class Skeleton:
    """Bones in order, each after its parent."""

    bones: tuple[Bone, ...]
    skin: Skin | None = None
    """The skin drawn around bones, if there is one; bones may have shapes besides."""
    shapes: Shapes | None = None
    """The surface of a soft body, if there is one; not part of `to_json`, as a file holds it as arrays."""

    def is_moved(self, number: int) -> bool:
        """Return whether anything moves bone `number` or one of its ancestors; a bone that nothing moves is scenery."""
        while number >= 0:
            if self.bones[number].is_moving:
                return True
            number = self.bones[number].parent
        return False

    def local_poses(self, states: Float[np.ndarray, "T S"]) -> Poses:
        """Return positions (T, B, 3) [m] and orientations wxyz (T, B, 4), each in its parent's frame."""
        positions = []
        orientations = []
        for bone in self.bones:
            position, orientation = _local_pose(bone, states)
            positions.append(position)
            orientations.append(orientation)
        return np.stack(positions, axis=1), np.stack(orientations, axis=1)

    def world_poses(self, states: Float[np.ndarray, "T S"]) -> Poses:
        """Return positions (T, B, 3) [m] and orientations wxyz (T, B, 4) in the world."""
        positions, orientations = self.local_poses(states)
        for i, bone in enumerate(self.bones):
            if bone.parent >= 0:
                parent = orientations[:, bone.parent]
                positions[:, i] = positions[:, bone.parent] + rotate(parent, positions[:, i])
                orientations[:, i] = multiply(parent, orientations[:, i])
        return positions, orientations

    def chain_to(self, name: str) -> tuple[Link, ...]:
        """Return the links from the world to the bone `name`; ArgumentError if there is none, or mass points move it."""
        by_name = {bone.name: bone for bone in self.bones}
        if name not in by_name:
            like = did_you_mean(name, by_name)
            raise ArgumentError(
                f"body: none is called '{name}'. {like}Bodies: {', '.join(by_name)}."
            )
        bone = by_name[name]
        if bone.binding is not None:
            raise ArgumentError(
                f"body: '{name}' follows mass points. Wanted one that joints move; reach_position is for all of it."
            )
        links = [bone.link]
        while bone.parent >= 0:
            bone = self.bones[bone.parent]
            links.append(bone.link)
        return tuple(reversed(links))

    def to_json(self) -> list[dict[str, Any]] | dict[str, Any]:
        """Return plain dictionaries, one per bone; under a skin, in a dictionary with it."""
        bones = self.bones_to_json()
        if self.skin is None:
            return bones
        return {"bones": bones, "skin": skin_to_json(self.skin)}

    def bones_to_json(self) -> list[dict[str, Any]]:
        """Return plain dictionaries, one per bone."""
        return [_bone_to_json(bone) for bone in self.bones]

    @classmethod
    def from_json(cls, described: Any, state_size: int | None = None) -> Skeleton:
        """Return the skeleton `to_json` wrote; ValueError names what is wrong with it.

        If `state_size` is given, no bone may read beyond that many state entries.
        """
        try:
            return _skeleton_from_json(described, state_size)
        except (TypeError, KeyError, AttributeError, OverflowError) as error:
            reason = str(error)[:MAX_REASON]
            raise ValueError(f"skeleton: {type(error).__name__} {reason}") from error


def kinematics_of(bones: Sequence[Bone]) -> Kinematics:
    """Return how joints move the links of these `bones`."""
    return Kinematics(tuple(bone.link for bone in bones), tuple(bone.parent for bone in bones))


def _skeleton_from_json(described: Any, state_size: int | None) -> Skeleton:
    if not isinstance(described, dict):
        described = {"bones": described, "skin": None}
    if {*described} != {"bones", "skin"} or not isinstance(described["bones"], list):
        raise ValueError("skeleton: wanted bones and a skin")
    rows = described["bones"]
    if len(rows) > MAX_BONES:
        raise ValueError(f"skeleton: {len(rows)} bones; wanted at most {MAX_BONES}")
    bones = tuple(_bone_from_json(row, number) for number, row in enumerate(rows))
    entries = max((_entries_read(bone) for bone in bones), default=0)
    if state_size is not None and entries > state_size:
        raise ValueError(f"skeleton: reads {entries} state entries of {state_size}")
    if described["skin"] is None:
        return Skeleton(bones)
    skin = skin_from_json(described["skin"])
    # The skins of deformable bodies are made around their bones, whose parent is the world.
    is_bound = isinstance(skin, MeshSkin) or all(bone.binding is not None for bone in bones)
    if not is_bound or not skin.fits([bone.offset for bone in bones]):
        raise ValueError("skeleton: its skin needs other bones")
    return Skeleton(bones, skin)


def _bone_to_json(bone: Bone) -> dict[str, Any]:
    row = asdict(bone)
    if bone.binding is None:
        del row["binding"]
    else:
        row["binding"] = bone.binding.model_dump(mode="json")
    return row


def _bone_from_json(row: Any, number: int) -> Bone:
    """Return a bone; only one of the `number` bones before it can be its parent."""
    if isinstance(row, dict):
        row = {"binding": None, **row}
    _check_keys(row, Bone)
    name = check_label(row["name"], f"bone {number}")
    label = f"bone '{name}'"
    joints = tuple(_joint_from_json(joint, label) for joint in _pieces(row["joints"], label))
    shapes = tuple(_shape_from_json(shape, label) for shape in _pieces(row["shapes"], label))
    binding = None
    if row["binding"] is not None:
        binding = binding_from_json(row["binding"])
    parent = whole(row["parent"], f"{label}: parent", -1, number - 1)
    if binding is not None and (joints or parent >= 0):
        raise ValueError(f"{label} follows mass points and has joints or a parent")
    return Bone(
        name=name,
        parent=parent,
        offset=_position(row["offset"], label),
        orientation=_unit_vector(row["orientation"], label, 4),
        joints=joints,
        shapes=shapes,
        binding=binding,
    )


def _joint_from_json(row: Any, label: str) -> Joint:
    _check_keys(row, Joint, JOINT_KINDS)
    return Joint(
        kind=row["kind"],
        entry=whole(row["entry"], f"{label}: entry", 0, MAX_ENTRIES),
        axis=_unit_vector(row["axis"], label, 3),
        anchor=_position(row["anchor"], label),
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
        kind=row["kind"],
        size=size,
        position=_position(row["position"], label),
        orientation=_unit_vector(row["orientation"], label, 4),
        colour=colour,
    )


def _position(value: Any, label: str) -> Numbers:
    return numbers(value, f"{label}: place", 3, MAX_DISTANCE)


def _unit_vector(value: Any, label: str, size: int) -> Numbers:
    """Return an axis, or a quaternion; a length of 0 would make poses NaN."""
    vector = numbers(value, f"{label}: axis or turn", size, MAX_COMPONENT)
    if abs(np.linalg.norm(vector) - 1) > UNIT_TOLERANCE:
        raise ValueError(
            f"{label}: wanted an axis or a turn of length 1, got {quoted(list(vector))}"
        )
    return vector


def _pieces(rows: Any, label: str) -> list[Any]:
    if not isinstance(rows, list) or len(rows) > MAX_PIECES:
        raise ValueError(f"{label}: wanted lists of at most {MAX_PIECES} joints and shapes")
    return rows


def _check_keys(row: Any, described: type, valid_kinds: tuple[str, ...] = ()) -> None:
    """Refuse a row without exactly the fields of the class `described`, or of a kind not among `valid_kinds`."""
    what = described.__name__.lower()
    names = {field.name for field in fields(described)}
    if not isinstance(row, dict) or {*row} != names:
        raise ValueError(f"skeleton: a {what} has unexpected or missing fields")
    if valid_kinds and row["kind"] not in valid_kinds:
        raise ValueError(f"skeleton: no {what} of the kind {quoted(row['kind'])} is known")


def _entries_read(bone: Bone) -> int:
    """Return the smallest number of state entries that holds all that moves `bone`."""
    ends = [joint.entry + JOINT_SIZES.get(joint.kind, 1) for joint in bone.joints]
    if bone.binding is not None:
        ends.append(bone.binding.last_entry + 1)
    return max(ends, default=0)


def _local_pose(bone: Bone, states: Float[np.ndarray, "T S"]) -> Pose:
    """Return positions and orientations of a bone in its parent's frame."""
    if bone.binding is not None:
        return bound_pose(bone.binding, states)
    return bone.link.local_pose(states)
