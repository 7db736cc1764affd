"""Joints, which let a bone move relative to its parent, and its resulting pose; for NumPy and JAX arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import AfterValidator, ConfigDict, Field

from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.rotation import multiply, rotate

Numbers = tuple[float, ...]
"""A vector or a quaternion in a skeleton: a few numbers, not an array."""

LocalPose = tuple[Float[AnyArray, "... 3"], Float[AnyArray, "... 4"]]
"""Positions [m] and orientations wxyz of one bone."""

JOINT_KINDS = ("hinge", "slide", "ball", "free")
"""Kinds of joints, as MuJoCo calls them."""

JOINT_SIZES = {"ball": 4, "free": 7}
"""Number of state entries a joint reads, if more than one."""

MAX_ENTRIES = 10**9
"""Largest state entry a joint may read before the state's size is known."""

MAX_DISTANCE = 1e6
"""Largest position and size drawn [m]."""

MAX_VALUE = 1e9
"""Largest value of a joint at its reference [rad or m]."""

UNIT_TOLERANCE = 1e-3
"""Tolerance of the length of a quaternion or an axis read from a file, which should be 1."""

EXACT = ConfigDict(extra="forbid")
"""Rule for reading a class from a file: no other fields than its own."""


def one_of(names: Sequence[str]) -> Any:
    """Return the rule that a text is one of `names`."""
    return Field(pattern=f"^({'|'.join(names)})$")


def _unit(vector: Numbers) -> Numbers:
    """Return an axis, or a quaternion; a length of 0 would make poses NaN."""
    if abs(np.linalg.norm(vector) - 1) > UNIT_TOLERANCE:
        raise ValueError("wanted an axis or a rotation of length 1")
    return vector


Distance = Annotated[float, Field(strict=True, ge=-MAX_DISTANCE, le=MAX_DISTANCE)]
"""A coordinate [m]."""

Component = Annotated[float, Field(strict=True, ge=-2, le=2)]
"""A component of an axis or a quaternion, before its length is checked."""

Point = Annotated[tuple[Distance, ...], Field(min_length=3, max_length=3, fail_fast=True)]
"""A point [m]."""

Axis = Annotated[
    tuple[Component, ...], Field(min_length=3, max_length=3, fail_fast=True), AfterValidator(_unit)
]
"""A unit vector."""

Quaternion = Annotated[
    tuple[Component, ...], Field(min_length=4, max_length=4, fail_fast=True), AfterValidator(_unit)
]
"""A quaternion wxyz."""


@dataclass(frozen=True)
class Joint:
    """A joint between a bone and its parent."""

    __pydantic_config__ = EXACT

    kind: Annotated[str, one_of(JOINT_KINDS)]
    """One of `JOINT_KINDS`."""
    entry: Annotated[int, Field(strict=True, ge=0, le=MAX_ENTRIES)]
    """First state entry it reads: an angle [rad], a distance [m], a quaternion, or a position and a quaternion."""
    axis: Axis
    """Unit axis of a hinge or slide in the bone's frame."""
    anchor: Point
    """Centre of rotation in the bone's frame [m]."""
    reference: Annotated[float, Field(strict=True, ge=-MAX_VALUE, le=MAX_VALUE)] = 0.0
    """Value of the entry at which the bone has its pose in the tree."""


@dataclass(frozen=True)
class Link:
    """A link of the kinematic tree: its pose in its parent, and its joints."""

    offset: Numbers
    """Its origin in the parent's frame [m], joints at their references."""
    orientation: Numbers
    """Quaternion wxyz in the parent's frame, joints at their references."""
    joints: tuple[Joint, ...]

    def local_pose(self, states: Float[AnyArray, "... S"]) -> LocalPose:
        """Return positions (..., 3) and orientations (..., 4) in the parent's frame, joint after joint as MuJoCo does."""
        position = _repeated(self.offset, states)
        orientation = _repeated(self.orientation, states)
        for joint in self.joints:
            if joint.kind == "free":
                position = states[..., joint.entry : joint.entry + 3]
                orientation = unit_quaternion(states, joint.entry + 3)
            elif joint.kind == "slide":
                distance = states[..., joint.entry, None] - joint.reference
                position = position + rotate(orientation, distance * _repeated(joint.axis, states))
            else:
                anchor = _repeated(joint.anchor, states)
                fixed = position + rotate(orientation, anchor)
                orientation = multiply(orientation, _rotation(joint, states))
                position = fixed - rotate(orientation, anchor)
        return position, orientation


def point_of_chain(
    chain: tuple[Link, ...], offset: Numbers, states: Float[AnyArray, "... S"]
) -> Float[AnyArray, "... 3"]:
    """Return the world position [m] of a point at `offset` [m] in the frame of the last link of `chain`."""
    point = _repeated(offset, states)
    for link in reversed(chain):
        position, orientation = link.local_pose(states)
        point = position + rotate(orientation, point)
    return point


def _rotation(joint: Joint, states: Float[AnyArray, "... S"]) -> Float[AnyArray, "... 4"]:
    """Return the quaternion of a ball joint, or of a hinge turned by its angle."""
    if joint.kind == "ball":
        return unit_quaternion(states, joint.entry)
    xp = states.__array_namespace__()
    half_angle = (states[..., joint.entry, None] - joint.reference) / 2
    axis = _repeated(joint.axis, states)
    return xp.concat([xp.cos(half_angle), xp.sin(half_angle) * axis], axis=-1)


def unit_quaternion(states: Float[AnyArray, "... S"], entry: int) -> Float[AnyArray, "... 4"]:
    """Return the quaternion that begins at `entry`, normalised."""
    quaternion = states[..., entry : entry + 4]
    norm = states.__array_namespace__().linalg.vector_norm
    return quaternion / norm(quaternion, axis=-1, keepdims=True)


def _repeated(numbers: Numbers, states: Float[AnyArray, "... S"]) -> Float[AnyArray, "... V"]:
    """Return `numbers` (V,) repeated for each state."""
    xp = states.__array_namespace__()
    vector = xp.asarray(np.array(numbers), dtype=states.dtype)
    return xp.broadcast_to(vector, (*states.shape[:-1], len(numbers)))
