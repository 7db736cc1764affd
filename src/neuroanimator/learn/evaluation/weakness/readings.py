"""Readings of a state, for people: its numbers where they mean something, else heights, speeds and angles.

A quaternion's four numbers, or the coordinates of forty mass points, mean nothing to a reader; the body's tilt and
turn rate do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.state.layout import entry_names, entry_units
from neuroanimator.state.pose import read_pose
from neuroanimator.state.reference_shape import Cloud, flat_of, points_of
from neuroanimator.state.rotation import rotate, to_body_axes, wrapped
from neuroanimator.state.segments import (
    Heading,
    Lag,
    PlacedSegment,
    Plain,
    PlanarPosition,
    PlanarVelocity,
    Position,
    Quaternion,
    Velocity,
    place_segments,
)
from neuroanimator.systems.system import System


class Reading(NamedTuple):
    """One number of every sample."""

    name: str
    """Name, such as `leg_joint.velocity`, or `root.velocity[2]` of a part with several numbers."""
    unit: str
    values: Float[np.ndarray, " N"]
    can_matter: bool = True
    """Whether the dynamics may depend on it: not on a free body's position in the plane, nor on its heading."""


def state_readings(system: System, states: Float[np.ndarray, "N S"]) -> list[Reading]:
    """Return the readings of `states` (N, S) of `system`."""
    structure = system.structure
    states = np.asarray(states, float)
    if structure.cloud is not None:
        readings = _cloud_readings(system, structure.cloud, states)
    elif structure.segments:
        readings = []
        for placed in place_segments(structure.segments):
            readings += _segment_readings(system, states, placed)
    else:
        readings = _entries(system, states, range(states.shape[1]))
    contacts = system.contact_counts(states)
    if contacts is not None and contacts.any():
        readings.append(Reading("contacts", "1", contacts.astype(float)))
    return readings


def control_readings(system: System, controls: Float[np.ndarray, "N C"]) -> list[Reading]:
    """Return each number of `controls` (N, C)."""
    names = entry_names(system.control)
    columns = zip(names, entry_units(system.control), np.asarray(controls, float).T, strict=True)
    return [Reading(*column) for column in columns]


def _entries(
    system: System, states: Float[np.ndarray, "N S"], entries: range, *, can_matter: bool = False
) -> list[Reading]:
    """Return state entries as they are; an angle of which only sine and cosine matter, within half a turn.

    They can matter where a network sees them, or by `can_matter`.
    """
    structure = system.structure
    names = entry_names(system.state)
    units = entry_units(system.state)
    readings = []
    for entry in entries:
        values = states[:, entry]
        is_plain = entry in structure.plain
        is_angle = any(row[entry] for row in structure.angles)
        if is_angle and not is_plain:
            values = wrapped(values)
        may = can_matter or is_plain or is_angle
        readings.append(Reading(names[entry], units[entry], values, may))
    return readings


def _segment_readings(
    system: System, states: Float[np.ndarray, "N S"], placed: PlacedSegment
) -> list[Reading]:
    """Return the readings of one segment of a state with a root that moves freely, or with balls."""
    segment = placed.segment
    entries = placed.indices
    values = states[:, placed.entries]
    readings = _entries(system, states, entries, can_matter=isinstance(segment, Lag))
    name = entry_names(system.state)[entries.start].rpartition("[")[0]
    if isinstance(segment, Quaternion):
        return [_rotation(system, name, values)]
    if isinstance(segment, Velocity | PlanarVelocity):
        speed = Reading(f"|{name}|", "m/s", np.linalg.norm(values, axis=1))
        rising = readings[2:] if isinstance(segment, Velocity) else []
        return [speed, *(reading._replace(can_matter=True) for reading in rising)]
    if isinstance(segment, Position | PlanarPosition | Heading):
        # Only the height of a free body's position can matter.
        height = 2 if isinstance(segment, Position) else None
        columns = zip(readings, values.T, strict=True)
        return [
            reading._replace(values=column, can_matter=number == height)
            for number, (reading, column) in enumerate(columns)
        ]
    return readings if isinstance(segment, Plain | Lag) else []


def _rotation(system: System, name: str, quaternions: Float[np.ndarray, "N 4"]) -> Reading:
    """Return a body's tilt from upright, or its rotation where there is no gravity."""
    moves = any(isinstance(segment, Position) for segment in system.structure.segments)
    if moves and system.structure.has_gravity:
        upward = rotate(quaternions, np.array([0.0, 0.0, 1.0]))
        return Reading(f"tilt of {name}", "rad", np.arccos(np.clip(upward[:, 2], -1, 1)))
    half = np.arccos(np.clip(np.abs(quaternions[:, 0]), 0, 1))
    return Reading(f"turn of {name}", "rad", 2 * half, can_matter=not moves)


def _cloud_readings(
    system: System, cloud: Cloud, states: Float[np.ndarray, "N S"]
) -> list[Reading]:
    """Return the readings of a deformable body as a whole, and of the rest of its state."""
    pose = read_pose(system.structure, states)
    size = 3 * cloud.count
    positions = points_of(states[:, :size])
    velocities = points_of(states[:, size : 2 * size])
    _, orientation, shape = cloud.own_frame(positions)
    own_velocities = to_body_axes(orientation, velocities - pose.velocity[:, None])
    turning = cloud.angular_velocity(shape, own_velocities)
    strain = flat_of(shape - np.array(cloud.positions))
    rows = [
        ("height", "m", pose.position[:, 2]),
        ("speed", "m/s", np.linalg.norm(pose.velocity, axis=1)),
        ("rising", "m/s", pose.velocity[:, 2]),
        ("tilt", "rad", np.arccos(np.clip(pose.upward[:, 2], -1, 1))),
        ("turning", "rad/s", np.linalg.norm(turning, axis=1)),
        ("deformation", "m", np.sqrt(np.mean(strain**2, axis=1))),
    ]
    if system.water_surface is not None:
        is_out = positions[..., 2] > system.water_surface
        rows.append(("share out of the water", "1", is_out.mean(axis=1)))
    lags = _entries(system, states, range(2 * size, states.shape[1]), can_matter=True)
    return [*(Reading(*row) for row in rows), *lags]
