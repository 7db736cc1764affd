"""Motions shown by default: a swimmer dives and keeps its depth, a soft body is thrown."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.pose import read_heights
from neuroanimator.state.reference_shape import Cloud, points_of
from neuroanimator.state.rotation import rotate, rotated_by
from neuroanimator.state.segments import Position, first_of_each, moves_freely

FIRST_BEND = 0.02
"""Bend of a swimmer's back to keep its depth, first guess, as a share of the controls' range."""

MAX_BEND = 0.15
"""Maximum bend of a swimmer's back, as a share of the controls' range."""

SECANTS = 4
"""Number of secant steps for that bend: an error of a few centimetres after five seconds is left."""

SAME_RISE = 1e-6
"""Difference between the rises of two guesses below which their slope is unknown [m]."""

DIVE = 0.6
"""Initial depth of a swimmer below the surface, over its length: its tail stays in the water."""

TOSS = 2.0
"""Height to which a soft body is thrown, over its size: enough to bounce, and low enough to be seen whole."""

TOSS_ORIENTATION = (0.1, 0.6)
"""Rotation at the throw, about its X and Y axes [rad]: it lands on a corner."""

TOSS_VELOCITY = np.array([0.6, 0.15, 1.0])
"""Its velocity when thrown, over its upward velocity."""

TOSS_ANGULAR_VELOCITY = np.array([0.3, 6.0, 0.2])
"""Angular velocity in flight [rad/s]: it rolls on."""

WELL_WITHIN = 0.8
"""Maximum speed and angular speed of a throw, as a share of the largest in training."""

GRAVITY = 9.81
"""Gravitational acceleration [m/s²]."""

UNDER_GROUND = 0.05
"""Maximum depth below the ground of a body that stands on it, over its height."""


def swims_under_a_surface(emulator: Emulator) -> bool:
    """Return whether this is a body of mass points, or of flesh that moves freely, in water with a surface."""
    structure = emulator.state_structure
    is_flesh = emulator.skeleton.shapes is not None and moves_freely(structure.segments)
    is_body = structure.cloud is not None or is_flesh
    return is_body and emulator.frame.is_immersed and bool(emulator.frame.probes)


def dive(emulator: Emulator, start: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """Return `start` of a swimmer, moved below the surface of the water in place."""
    entries, length = whole_body(emulator)
    depth = _surface_height(emulator) - DIVE * length
    start[entries][2::3] += depth - _height(emulator, start)
    return start


def whole_body(emulator: Emulator) -> tuple[slice, float]:
    """Return (the state entries of positions that move with the whole body, of its mass points or its root; its length [m])."""
    structure = emulator.state_structure
    if structure.cloud is not None:
        entries = slice(0, 3 * structure.cloud.count)
        return entries, float(np.ptp(points_of(emulator.rest[entries]), axis=0).max())
    shapes = emulator.skeleton.shapes
    assert shapes is not None
    entries = first_of_each(structure.segments)[Position].entries
    return entries, float(np.ptp(shapes.mean, axis=0).max())


def level_swim(
    emulator: Emulator, start: Float[np.ndarray, " S"], controls: Float[np.ndarray, "T C"]
) -> Float[np.ndarray, "T C"]:
    """Return `controls` of a gait with the back bent a little, such that the swim ends at the depth where it begins.

    The bend is added to the muscles in the direction of the gait, and found by the secant method.
    """
    assert emulator.gait is not None
    bounds = emulator.bounds
    sense = np.sign(emulator.gait.amplitudes) * bounds.half

    def rise_of(bend: float) -> float:
        states = np.array(emulator.rollout(start, bounds.clip(controls + bend * sense)), float)
        return _height(emulator, states[-1]) - _height(emulator, states[0])

    last_bend = 0.0
    last_rise = rise_of(last_bend)
    bend = FIRST_BEND
    for _ in range(SECANTS):
        rise = rise_of(bend)
        if abs(rise - last_rise) < SAME_RISE:
            break
        slope = (rise - last_rise) / (bend - last_bend)
        last_bend = bend
        last_rise = rise
        bend = float(np.clip(bend - rise / slope, -MAX_BEND, MAX_BEND))
    return bounds.clip(controls + bend * sense)


def is_soft_on_ground(emulator: Emulator) -> bool:
    """Return whether this is a body of mass points that at rest lies wholly above the level its heights count from."""
    frame = emulator.frame
    cloud = emulator.state_structure.cloud
    if cloud is None or not frame.has_gravity or frame.is_immersed:
        return False
    heights = points_of(emulator.rest[: 3 * cloud.count])[:, 2]
    lowest = _surface_height(emulator) - UNDER_GROUND * float(np.ptp(heights))
    return float(heights.min()) > lowest


def throw(emulator: Emulator, start: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """Return the start of `throw_body`, at speeds that the emulator was trained for."""
    cloud = emulator.state_structure.cloud
    assert cloud is not None
    return throw_body(
        cloud, start, emulator.encoding.max_speed, emulator.encoding.max_angular_speed
    )


def throw_body(
    cloud: Cloud,
    start: Float[np.ndarray, " S"],
    max_speed: float = np.inf,
    max_angular_speed: float = np.inf,
) -> Float[np.ndarray, " S"]:
    """Return `start` of a soft body, changed in place: rotated, above the ground, and flying up, forward and spinning.

    It stays well within `max_speed` [m/s] and `max_angular_speed` [rad/s].
    """
    positions = points_of(start[: 3 * cloud.count])
    velocities = points_of(start[3 * cloud.count : 6 * cloud.count])
    size = float(np.ptp(positions, axis=0).max())
    centre = positions.mean(axis=0)
    about_x, about_y = TOSS_ORIENTATION
    orientation = np.array([1.0, 0.0, 0.0, 0.0])
    for angles in ((about_x, 0.0, 0.0), (0.0, about_y, 0.0)):
        orientation = rotated_by(orientation, 2 * np.tan(np.array(angles) / 2))
    offsets = rotate(np.broadcast_to(orientation, (len(positions), 4)), positions - centre)
    # It begins at half the height of the throw and climbs the other half: v² = 2 g (TOSS / 2) size.
    velocity = TOSS_VELOCITY * np.sqrt(GRAVITY * TOSS * size)
    velocity *= _share_within(velocity, max_speed)
    spin = TOSS_ANGULAR_VELOCITY * _share_within(TOSS_ANGULAR_VELOCITY, max_angular_speed)
    positions[:] = centre + np.array([0.0, 0.0, TOSS / 2 * size]) + offsets
    velocities[:] = velocity + np.cross(spin, offsets)
    return start


def _share_within(vector: Float[np.ndarray, " 3"], limit: float) -> float:
    """Return the share of `vector`, at most 1, that is well within `limit`."""
    return min(1.0, WELL_WITHIN * limit / float(np.linalg.norm(vector)))


def _surface_height(emulator: Emulator) -> float:
    """Return the height of the ground or the water [m], from which the frame's probes are measured."""
    return emulator.frame.probes[0][3] if emulator.frame.probes else 0.0


def _height(emulator: Emulator, state: Float[np.ndarray, " S"]) -> float:
    """Return the mean height of the mass points, or that of the root [m]."""
    return float(read_heights(emulator.state_structure, state).mean())
