"""Joints, which let a bone move relative to its parent, and its resulting pose; for NumPy and JAX arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

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


@dataclass(frozen=True)
class Joint:
    """A joint between a bone and its parent."""

    kind: str
    """One of `JOINT_KINDS`."""
    entry: int
    """First state entry it reads: an angle [rad], a distance [m], a quaternion, or a position and a quaternion."""
    axis: Numbers
    """Unit axis of a hinge or slide in the bone's frame."""
    anchor: Numbers
    """Centre of rotation in the bone's frame [m]."""
    reference: float = 0.0
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
