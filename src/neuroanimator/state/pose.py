"""Position and heading of a body, for every kind of state."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.reference_shape import points_of
from neuroanimator.state.rotation import cross, rotate
from neuroanimator.state.segments import (
    Position,
    Quaternion,
    Velocity,
    first_of_each,
    moves_freely,
)
from neuroanimator.state.structure import Structure


class Pose(NamedTuple):
    """Pose of one body, or many, in the world."""

    position: Float[AnyArray, "... 3"]
    """Position of the root, or of a deformable body's centroid [m]."""
    velocity: Float[AnyArray, "... 3"]
    """Velocity of the same point [m/s]."""
    forward: Float[AnyArray, "... 3"]
    """Unit vector along the body's X."""
    upward: Float[AnyArray, "... 3"]
    """Unit vector along the body's Z."""

    @property
    def heading(self) -> Float[AnyArray, " ..."]:
        """Heading (...) [rad]: the angle of the body's forward axis from the world's X axis, seen from above."""
        xp = self.forward.__array_namespace__()
        return xp.atan2(self.forward[..., 1], self.forward[..., 0])

    @property
    def roll(self) -> Float[AnyArray, " ..."]:
        """Roll (...) [rad] to its right about its own axis: 0 upright, ±π belly up.

        Pitch and heading do not count. It is meaningless for a body that points straight up or down.
        """
        xp = self.forward.__array_namespace__()
        left = cross(self.upward, self.forward)
        above = cross(self.forward, left)
        return xp.atan2(left[..., 2], above[..., 2])


def has_pose(structure: Structure) -> bool:
    """Return whether states have a pose: that of a freely moving root, or of mass points."""
    return structure.cloud is not None or moves_freely(structure.segments)


@runtime_checkable
class HasStructure(Protocol):
    """An object whose states have a structure, such as a system."""

    @property
    def structure(self) -> Structure:
        """The structure of its states."""
        ...


def read_pose(structure: Structure | HasStructure, states: Float[AnyArray, "... S"]) -> Pose:
    """Return the poses of `states` (..., S) of this structure, or of a system's.

    A deformable body points along the first moment of its mass points about their centroid, weighted by their
    positions at rest along X (or Z): for a stiff symmetric body exactly its own axis, and smooth for all.

    Raises ArgumentError for a system without a freely moving root or mass points.
    """
    if isinstance(structure, HasStructure):
        structure = structure.structure
    if structure.cloud is not None:
        return _cloud_pose(structure, states)
    if has_pose(structure):
        return _root_pose(structure, states)
    raise ArgumentError(
        "position, speed and heading: wanted a system with a free root or mass points, got one without. "
        "Give the wanted state entries instead (reach_state)."
    )


def read_heights(
    structure: Structure, states: Float[AnyArray, "... S"]
) -> Float[AnyArray, "... N"]:
    """Return the heights (..., N) [m] of all mass points of `states` (..., S), or (..., 1) of a rigid body's root.

    Raises ArgumentError as `read_pose` does.
    """
    if structure.cloud is None:
        return read_pose(structure, states).position[..., 2:]
    return states[..., 2 : 3 * structure.cloud.count : 3]


def _root_pose(structure: Structure, states: Float[AnyArray, "... S"]) -> Pose:
    xp = states.__array_namespace__()
    root = first_of_each(structure.segments)
    orientation = states[..., root[Quaternion].entries]
    x_axis = xp.asarray(np.eye(3)[0], dtype=states.dtype)
    z_axis = xp.asarray(np.eye(3)[2], dtype=states.dtype)
    return Pose(
        position=states[..., root[Position].entries],
        velocity=states[..., root[Velocity].entries],
        forward=rotate(orientation, x_axis),
        upward=rotate(orientation, z_axis),
    )


def _cloud_pose(structure: Structure, states: Float[AnyArray, "... S"]) -> Pose:
    xp = states.__array_namespace__()
    cloud = structure.cloud
    assert cloud is not None
    size = 3 * cloud.count
    positions = points_of(states[..., :size])
    velocities = points_of(states[..., size : 2 * size])
    centre = cloud.centroid(positions)
    moments = np.array(cloud.positions) * np.array(cloud.masses)[:, None]
    weights = xp.asarray(moments[:, [0, 2]].T, dtype=states.dtype)
    axes = weights @ (positions - centre[..., None, :])
    axes = axes / xp.linalg.vector_norm(axes, axis=-1, keepdims=True)
    return Pose(centre, cloud.centroid(velocities), axes[..., 0, :], axes[..., 1, :])
