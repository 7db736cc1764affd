"""The skeleton of a state: a tree of bones with joints and simple shapes, or bones under a skin; and its JSON.

Needs no physics engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import Field, ValidationError

from neuroanimator.appearance.binding import Binding, bound_pose
from neuroanimator.appearance.mesh_skin import MeshSkin
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skin import Skin
from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import LABEL_PATTERN
from neuroanimator.files.tables import Table, first_fault
from neuroanimator.state.kinematics import Kinematics
from neuroanimator.state.links import (
    EXACT,
    JOINT_SIZES,
    MAX_DISTANCE,
    Joint,
    Link,
    Point,
    Quaternion,
    one_of,
)
from neuroanimator.state.rotation import multiply, rotate
from neuroanimator.text import did_you_mean

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

Size = Annotated[float, Field(strict=True, ge=0, le=MAX_DISTANCE)]
"""A size of a shape [m]."""

Shade = Annotated[float, Field(strict=True, ge=0, le=1)]
"""An amount of a colour, or an opacity."""


@dataclass(frozen=True)
class Shape:
    """Something to draw, fixed to a bone."""

    __pydantic_config__ = EXACT

    kind: Annotated[str, one_of(SHAPE_KINDS)]
    """One of `SHAPE_KINDS`."""
    size: Annotated[tuple[Size, ...], Field(max_length=MAX_SIZES, fail_fast=True)]
    """Radius and half length along Z (capsule, cylinder), radius (sphere), half axes (box, ellipsoid) [m]."""
    position: Point
    """Its middle in the bone's frame [m]."""
    orientation: Quaternion
    """Quaternion wxyz in the bone's frame."""
    colour: Annotated[tuple[Shade, ...], Field(min_length=4, max_length=4, fail_fast=True)]
    """Red, green, blue, opacity, each 0 to 1."""


@dataclass(frozen=True)
class Bone:
    """One rigid part: its parent, the joints that move it, and its shapes."""

    __pydantic_config__ = EXACT

    name: Annotated[str, Field(pattern=LABEL_PATTERN)]
    parent: Annotated[int, Field(strict=True, ge=-1)]
    """Index of its parent bone; -1 for the world."""
    offset: Point
    """Its origin in the parent's frame [m], joints at their references."""
    orientation: Quaternion
    """Quaternion wxyz in the parent's frame, joints at their references."""
    joints: Annotated[tuple[Joint, ...], Field(max_length=MAX_PIECES, fail_fast=True)]
    shapes: Annotated[tuple[Shape, ...], Field(max_length=MAX_PIECES, fail_fast=True)]
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
            if bone.binding is None:
                position, orientation = bone.link.local_pose(states)
            else:
                position, orientation = bound_pose(bone.binding, states)
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
        return {"bones": bones, "skin": self.skin.model_dump(mode="json")}

    def bones_to_json(self) -> list[dict[str, Any]]:
        """Return plain dictionaries, one per bone."""
        described = _Described(bones=self.bones, skin=None).model_dump(
            mode="json", exclude_none=True
        )
        return described["bones"]

    @classmethod
    def from_json(cls, described: Any, state_size: int | None = None) -> Skeleton:
        """Return the skeleton `to_json` wrote; ValueError names what is wrong with it.

        If `state_size` is given, no bone may read beyond that many state entries.
        """
        if not isinstance(described, dict):
            described = {"bones": described, "skin": None}
        try:
            read = _Described.model_validate(described)
        except ValidationError as error:
            raise ValueError(f"skeleton: {first_fault(error)}") from error
        bones = read.bones
        for number, bone in enumerate(bones):
            _check_bone(bone, number, state_size)
        skin = read.skin
        if skin is not None:
            # The skins of deformable bodies are made around their bones, whose parent is the world.
            is_bound = isinstance(skin, MeshSkin) or all(bone.binding for bone in bones)
            if not is_bound or not skin.fits([bone.offset for bone in bones]):
                raise ValueError("skeleton: its skin needs other bones")
        return cls(bones, skin)


class _Described(Table):
    """A skeleton in a file."""

    bones: Annotated[tuple[Bone, ...], Field(max_length=MAX_BONES, fail_fast=True)]
    skin: Annotated[Skin, Field(discriminator="kind")] | None


def kinematics_of(bones: Sequence[Bone]) -> Kinematics:
    """Return how joints move the links of these `bones`."""
    return Kinematics(tuple(bone.link for bone in bones), tuple(bone.parent for bone in bones))


def _check_bone(bone: Bone, number: int, state_size: int | None) -> None:
    """Refuse a bone, the one of this `number`, that reads beyond the state, or whose parent is not among those before it."""
    label = f"bone '{bone.name}'"
    if bone.parent >= number:
        raise ValueError(f"{label}: wanted a parent before it")
    if bone.binding is not None and (bone.joints or bone.parent >= 0):
        raise ValueError(f"{label} follows mass points and has joints or a parent")
    for shape in bone.shapes:
        if len(shape.size) < SHAPE_SIZES[shape.kind]:
            raise ValueError(f"{label}: a {shape.kind} with {len(shape.size)} sizes")
    entries = _entries_read(bone)
    if state_size is not None and entries > state_size:
        raise ValueError(f"{label}: reads {entries} state entries of {state_size}")


def _entries_read(bone: Bone) -> int:
    """Return the smallest number of state entries that holds all that moves `bone`."""
    ends = [joint.entry + JOINT_SIZES.get(joint.kind, 1) for joint in bone.joints]
    if bone.binding is not None:
        ends.append(bone.binding.last_entry + 1)
    return max(ends, default=0)
