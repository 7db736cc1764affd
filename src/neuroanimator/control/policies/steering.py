"""Skills: a wished course in the world, and the command that leads a body there from its present pose."""

from __future__ import annotations

from typing import NamedTuple

from neuroanimator.state.pose import Pose
from neuroanimator.state.rotation import Numbers, cross

NEARLY_NOTHING = 1e-6
"""Added under roots and to lengths, so that slopes stay finite."""


class SteeringTarget(NamedTuple):
    """Where bodies want to go, all in the world."""

    direction: Numbers
    """(..., 3) unit vector"""
    speed: Numbers
    """(...) [m/s]"""


def forward(pose: Pose, speed: Numbers) -> SteeringTarget:
    """Return the course straight ahead at `speed` [m/s]."""
    return SteeringTarget(pose.forward, _alike(speed, pose))


def turn(pose: Pose, angle: Numbers, speed: Numbers) -> SteeringTarget:
    """Return the course `angle` [rad] to the left of where the body points, as the body sees it."""
    return SteeringTarget(_between(pose.forward, leftward(pose), angle), _alike(speed, pose))


def dive(pose: Pose, angle: Numbers, speed: Numbers) -> SteeringTarget:
    """Return the course `angle` [rad] below where the body points, as the body sees it."""
    return SteeringTarget(_between(pose.forward, -upright(pose), angle), _alike(speed, pose))


def command(course: SteeringTarget, pose: Pose) -> Numbers:
    """Return the commands (..., 4) of `policy.COMMAND` that lead from `pose` to `course`."""
    xp = pose.position.__array_namespace__()
    left, up = leftward(pose), upright(pose)
    ahead, aside, above = (_dot(course.direction, axis) for axis in (pose.forward, left, up))
    climb = xp.atan2(above, xp.sqrt(ahead**2 + aside**2 + NEARLY_NOTHING))
    return xp.stack([course.speed, xp.atan2(aside, ahead), climb, -pose.roll], axis=-1)


def leftward(pose: Pose) -> Numbers:
    """Return the unit vectors (..., 3) to the bodies' left."""
    return unit(cross(pose.upward, pose.forward))


def upright(pose: Pose) -> Numbers:
    """Return the unit vectors (..., 3) upward from the bodies, across where they point."""
    return cross(pose.forward, leftward(pose))


def unit(vectors: Numbers) -> Numbers:
    """Return `vectors` (..., 3) of length one; those of no length stay so."""
    return vectors / (_length(vectors) + NEARLY_NOTHING)[..., None]


def _length(vectors: Numbers) -> Numbers:
    return vectors.__array_namespace__().sqrt(_dot(vectors, vectors) + NEARLY_NOTHING**2)


def _dot(first: Numbers, second: Numbers) -> Numbers:
    return first.__array_namespace__().sum(first * second, axis=-1)


def _between(first: Numbers, second: Numbers, angle: Numbers) -> Numbers:
    """Return what lies `angle` from `first` (..., 3) toward `second`, which is across."""
    xp = first.__array_namespace__()
    turned = xp.asarray(angle, dtype=first.dtype)
    return xp.cos(turned)[..., None] * first + xp.sin(turned)[..., None] * second


def _alike(speed: Numbers, pose: Pose) -> Numbers:
    """Return `speed` for each of the bodies."""
    xp = pose.forward.__array_namespace__()
    return xp.zeros_like(pose.forward[..., 0]) + xp.asarray(speed, dtype=pose.forward.dtype)
