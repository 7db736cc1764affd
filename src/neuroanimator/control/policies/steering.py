"""Steering: targets of bodies in the world, and the commands that lead there from their current poses."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.pose import Pose
from neuroanimator.state.rotation import cross

EPSILON = 1e-6
"""Offset added under roots and to lengths, so that gradients of zero vectors stay finite."""


class SteeringTarget(NamedTuple):
    """Targets of bodies, in world coordinates."""

    direction: Float[AnyArray, "*B 3"]
    """Unit vector along which each is to point and move."""
    speed: Float[AnyArray, "*B"]
    """Target speed of each along its own X axis [m/s]."""


def steer_forward(pose: Pose, speed: ArrayLike) -> SteeringTarget:
    """Return the target straight ahead of the bodies (*B) at `speed`, one for all or (*B) [m/s]."""
    return SteeringTarget(pose.forward, for_each(speed, pose.forward))


def steer_left(pose: Pose, angle: ArrayLike, speed: ArrayLike) -> SteeringTarget:
    """Return the target `angle` [rad] to the left of where the bodies (*B) point, in their own frames.

    `angle` and `speed` [m/s] are one for all or (*B); a negative angle is to the right.
    """
    direction = rotated_toward(leftward(pose), pose.forward, angle)
    return SteeringTarget(direction, for_each(speed, pose.forward))


def steer_down(pose: Pose, angle: ArrayLike, speed: ArrayLike) -> SteeringTarget:
    """Return the target `angle` [rad] below where the bodies (*B) point, in their own frames.

    `angle` and `speed` [m/s] are one for all or (*B); a negative angle is above.
    """
    direction = rotated_toward(-upright(pose), pose.forward, angle)
    return SteeringTarget(direction, for_each(speed, pose.forward))


def command_toward(target: SteeringTarget, pose: Pose) -> Float[AnyArray, "*B 4"]:
    """Return the commands, as `policy.COMMAND` names them, that lead from `pose` to `target`."""
    xp = pose.position.__array_namespace__()
    left = leftward(pose)
    up = upright(pose)
    ahead = _dot(target.direction, pose.forward)
    aside = _dot(target.direction, left)
    above = _dot(target.direction, up)
    climb = xp.atan2(above, xp.sqrt(ahead**2 + aside**2 + EPSILON))
    turn = xp.atan2(aside, ahead)
    return xp.stack([target.speed, turn, climb, -pose.roll], axis=-1)


def leftward(pose: Pose) -> Float[AnyArray, "*B 3"]:
    """Return the unit vectors to the bodies' left."""
    return unit(cross(pose.upward, pose.forward))


def upright(pose: Pose) -> Float[AnyArray, "*B 3"]:
    """Return the unit vectors upward from the bodies, orthogonal to where they point."""
    return cross(pose.forward, leftward(pose))


def unit(vectors: Float[AnyArray, "*B 3"]) -> Float[AnyArray, "*B 3"]:
    """Return `vectors` normalised; zero vectors stay zero."""
    length = vectors.__array_namespace__().sqrt(_dot(vectors, vectors) + EPSILON**2)
    return vectors / (length + EPSILON)[..., None]


def _dot(
    left: Float[AnyArray, "*#B 3"], right: Float[AnyArray, "*#B 3"]
) -> Float[AnyArray, " ..."]:
    return left.__array_namespace__().sum(left * right, axis=-1)


def rotated_toward(
    side: Float[AnyArray, "*B 3"], forward: Float[AnyArray, "*B 3"], angle: ArrayLike
) -> Float[AnyArray, "*B 3"]:
    """Return `forward` rotated by `angle` [rad] toward the orthogonal `side`."""
    xp = forward.__array_namespace__()
    angles = xp.asarray(angle, dtype=forward.dtype)
    return xp.cos(angles)[..., None] * forward + xp.sin(angles)[..., None] * side


def for_each(speed: ArrayLike, directions: Float[AnyArray, "*B 3"]) -> Float[AnyArray, "*B"]:
    """Return the speed, one for all or (*B), of each body."""
    xp = directions.__array_namespace__()
    return xp.zeros_like(directions[..., 0]) + xp.asarray(speed, dtype=directions.dtype)
