"""What a person reads off a state: each number where that says something, and heights, speeds and angles where not.

A quaternion's four numbers, or the coordinates of forty mass points, say nothing to anybody; how far the body is
tilted, and how fast it turns, do.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.state.layout import Layout
from neuroanimator.state.pose import read_pose
from neuroanimator.state.reference_shape import flat_of, points_of, to_body_axes
from neuroanimator.state.rotation import rotate
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
    """Such as `leg_joint.velocity`, or `root.velocity[2]` of a part with several numbers."""
    unit: str
    values: Float[np.ndarray, " N"]
    can_matter: bool = True
    """Whether what happens next may depend on it: not on where in the plane a free body is, nor where it heads."""


def entry_names(layout: Layout) -> list[str]:
    """Return a name per entry, without its unit; parts of one number without an index."""
    names = []
    for part in layout.slices:
        if part.size == 1:
            names.append(part.name)
        else:
            names += [f"{part.name}[{number}]" for number in range(part.size)]
    return names


def entry_units(layout: Layout) -> list[str]:
    """Return the unit of each entry."""
    return [part.unit for part in layout.slices for _ in range(part.size)]


def state_readings(system: System, states: Float[np.ndarray, "N S"]) -> list[Reading]:
    """Return what is to be read off `states` (N, S) of `system`."""
    if system.structure.cloud is not None:
        readings = list(_cloud_readings(system, states))
    elif system.structure.segments:
        readings = list(_segment_readings(system, states))
    else:
        readings = [_entry(system, states, entry) for entry in range(states.shape[1])]
    return readings + contact_readings(system, states)


def control_readings(system: System, controls: Float[np.ndarray, "N C"]) -> list[Reading]:
    """Return each number of `controls` (N, C)."""
    names = entry_names(system.control)
    units = entry_units(system.control)
    columns = zip(names, units, np.asarray(controls, float).T, strict=True)
    return [Reading(name, unit, values) for name, unit, values in columns]


def contact_readings(system: System, states: Float[np.ndarray, "N S"]) -> list[Reading]:
    """Return how many contacts there are in each of `states`; nothing of what touches nothing."""
    counts = system.contact_counts(states)
    if counts is None or not counts.any():
        return []
    return [Reading("contacts", "1", counts.astype(float))]


def _entry(system: System, states: Float[np.ndarray, "N S"], entry: int) -> Reading:
    """Return a state entry as it is; an angle of which only sine and cosine matter, within half a turn."""
    structure = system.structure
    values = np.asarray(states[:, entry], float)
    is_plain = entry in structure.plain
    is_angle = any(row[entry] for row in structure.angles)
    if is_angle and not is_plain:
        values = (values + np.pi) % (2 * np.pi) - np.pi
    can_matter = is_plain or is_angle
    return Reading(entry_names(system.state)[entry], _unit(system, entry), values, can_matter)


def _unit(system: System, entry: int) -> str:
    return entry_units(system.state)[entry]


def _part_name(system: System, entry: int) -> str:
    """Return the name of the part that a state entry belongs to."""
    start = 0
    for part in system.state.slices:
        start += part.size
        if entry < start:
            return part.name
    raise IndexError(entry)


def _segment_readings(system: System, states: Float[np.ndarray, "N S"]) -> Iterator[Reading]:
    """Yield the readings of a state with a root that moves freely, or with balls."""
    for placed in place_segments(system.structure.segments):
        segment = placed.segment
        if isinstance(segment, Quaternion):
            yield _turn(system, states, placed)
        elif isinstance(segment, Velocity | PlanarVelocity):
            yield from _velocity(system, states, placed)
        elif isinstance(segment, Position | PlanarPosition | Heading):
            yield from _place(system, states, placed)
        elif isinstance(segment, Plain):
            for entry in range(placed.entries.start, placed.entries.stop):
                yield _entry(system, states, entry)
        elif isinstance(segment, Lag):
            yield from _lags(system, states, placed.entries)


def _turn(system: System, states: Float[np.ndarray, "N S"], placed: PlacedSegment) -> Reading:
    """Return how far a body is tilted out of the upright, or turned where nothing pulls it down."""
    quaternions = np.asarray(states[:, placed.entries], float)
    name = _part_name(system, placed.entries.start)
    moves = any(isinstance(segment, Position) for segment in system.structure.segments)
    if moves and system.structure.has_gravity:
        upward = rotate(quaternions, np.array([0.0, 0.0, 1.0]))
        return Reading(f"tilt of {name}", "rad", np.arccos(np.clip(upward[:, 2], -1, 1)))
    half = np.arccos(np.clip(np.abs(quaternions[:, 0]), 0, 1))
    return Reading(f"turn of {name}", "rad", 2 * half, can_matter=not moves)


def _velocity(
    system: System, states: Float[np.ndarray, "N S"], placed: PlacedSegment
) -> Iterator[Reading]:
    """Yield how fast a free body is, and how fast it rises."""
    velocities = np.asarray(states[:, placed.entries], float)
    name = _part_name(system, placed.entries.start)
    yield Reading(f"|{name}|", "m/s", np.linalg.norm(velocities, axis=1))
    if isinstance(placed.segment, Velocity):
        yield Reading(f"{name}[2]", "m/s", velocities[:, 2])


def _place(
    system: System, states: Float[np.ndarray, "N S"], placed: PlacedSegment
) -> Iterator[Reading]:
    """Yield where a free body is: only its height can matter."""
    names = entry_names(system.state)
    for number, entry in enumerate(range(placed.entries.start, placed.entries.stop)):
        is_height = isinstance(placed.segment, Position) and number == 2
        values = np.asarray(states[:, entry], float)
        yield Reading(names[entry], _unit(system, entry), values, can_matter=is_height)


def _cloud_readings(system: System, states: Float[np.ndarray, "N S"]) -> Iterator[Reading]:
    """Yield the readings of a deformable body as a whole, and of whatever else is in its state."""
    cloud = system.structure.cloud
    assert cloud is not None
    states = np.asarray(states, float)
    pose = read_pose(system.structure, states)
    size = 3 * cloud.count
    positions = points_of(states[:, :size])
    velocities = points_of(states[:, size : 2 * size])
    _, orientation, shape = cloud.own_frame(positions)
    drift = velocities - pose.velocity[:, None]
    own_velocities = to_body_axes(orientation, drift)
    turning = cloud.angular_velocity(shape, own_velocities)
    strain = flat_of(shape - np.array(cloud.positions))
    yield Reading("height", "m", pose.position[:, 2])
    yield Reading("speed", "m/s", np.linalg.norm(pose.velocity, axis=1))
    yield Reading("rising", "m/s", pose.velocity[:, 2])
    yield Reading("tilt", "rad", np.arccos(np.clip(pose.upward[:, 2], -1, 1)))
    yield Reading("turning", "rad/s", np.linalg.norm(turning, axis=1))
    yield Reading("deformation", "m", np.sqrt(np.mean(strain**2, axis=1)))
    if system.water_surface is not None:
        is_out = positions[..., 2] > system.water_surface
        yield Reading("share out of the water", "1", is_out.mean(axis=1))
    yield from _lags(system, states, slice(2 * size, states.shape[1]))


def _lags(system: System, states: Float[np.ndarray, "N S"], entries: slice) -> Iterator[Reading]:
    """Yield numbers that follow their controls, such as muscles: they matter, whatever the network is shown."""
    for entry in range(entries.start, entries.stop):
        yield _entry(system, states, entry)._replace(can_matter=True)
