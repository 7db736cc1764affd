"""Laps of a motion on command, from standing to the fastest gait, as seen from a root that stays at the origin.

clips → one lap of each, rotated so that the root goes along X
standing, walk → laps of shorter strides
walk, run → the run, aligned with the walk's phase and clock → laps of strides between the two, and of longer ones
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.control.policies.commands import (
    LEAST_FASTER,
    STANDING_PACE,
    Command,
    Commands,
    FasterGait,
)
from neuroanimator.control.policies.reference_motion import (
    MAX_FRAMES,
    ORIENTATION,
    POSITION,
    TURN,
)
from neuroanimator.definitions.follow import CommandsTable
from neuroanimator.errors import BadFileError
from neuroanimator.gym.mixed_strides import mixed_strides
from neuroanimator.physics.rigid.joints import JointView
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.rotation import (
    facing,
    heading_of,
    multiply,
    of_unit_length,
    rotate,
    upward,
)

STRIDES = (0.0, 1 / 3, 2 / 3)
"""Lengths of the shorter strides stored with a motion on command, relative to its own."""

SHARES = (0.5, 1.0, 1.5)
"""Shares of the faster gait in the laps beyond the slower one. Above 1 strides are extrapolated, since people also run faster by
longer strides."""

MIN_SPEED = 0.01
"""Minimum mean speed of a motion whose speed is commanded [m/s]."""


class GaitClip(NamedTuple):
    """A clip of one cycle of a gait, and its file."""

    path: Path
    states: Float[np.ndarray, "K S"]


class GaitEntries(NamedTuple):
    """Entries of the state that describe a gait."""

    clock: JointView
    heading: JointView
    velocity: int
    """First entry of the root's velocity."""
    hinges: tuple[int, ...]
    """Entries of the body's joint angles."""


def on_command(
    body: MujocoSystem,
    walk: GaitClip,
    run: GaitClip | None,
    table: CommandsTable,
    feet: tuple[str, ...],
    entries: GaitEntries,
    dt: float,
) -> tuple[Float[np.ndarray, "K S"], Commands]:
    """Return (laps one after another, the mapping of commands to them) of a gait, and of a faster one if given.

    States are `dt` apart [s]. BadFileError for a clip that goes nowhere or is too long, and for a faster gait that is no faster.
    """
    clock = entries.clock.position_entry
    lap = _from_heading(walk, entries, dt)
    laps_in_all = len(STRIDES) + 1 + (len(SHARES) if run is not None else 0)
    if len(lap) * laps_in_all > MAX_FRAMES:
        raise BadFileError(
            f"{walk.path}: {len(lap):,} states; wanted at most {MAX_FRAMES // laps_in_all:,} of a motion on command. Give a "
            "shorter cycle."
        )
    commands = Commands(
        heading=entries.heading.position_entry,
        turning=entries.heading.velocity_entry,
        clock_rate=entries.clock.velocity_entry,
        own_rate=float(walk.states[0, entries.clock.velocity_entry]),
        own_speed=_speed(walk, lap, entries.velocity),
        least=Command(table.speed[0], table.turning[0]),
        most=Command(table.speed[1], table.turning[1]),
        standing_pace=STANDING_PACE,
    )
    standing = np.tile(_standing(body), (len(lap), 1))
    laps = []
    for stride in STRIDES:
        # Feet are lifted by more than the share of the stride, to clear the floor on short strides.
        lifting = np.sqrt(stride)
        laps.append(mixed_strides(body.model, standing, lap, stride, lifting, feet, dt, clock))
    laps.append(lap)
    if run is not None:
        own = _from_heading(run, entries, dt)
        pace, stride = _pace_and_stride(run, _speed(run, own, entries.velocity), walk, commands)
        fastest = SHARES[-1]
        faster = FasterGait(1 + fastest * (pace - 1), 1 + fastest * (stride - 1), len(SHARES))
        commands = commands._replace(faster=faster)
        fast = _by_clock_of(lap, own, pace, body.model.nq, entries)
        for share in SHARES:
            laps.append(mixed_strides(body.model, lap, fast, share, share, feet, dt, clock))
    return np.concatenate(laps), commands


def _pace_and_stride(
    run: GaitClip, speed: float, walk: GaitClip, commands: Commands
) -> tuple[float, float]:
    """Return (pace, stride) of a run relative to the walk's lap rate and lap length; BadFileError if it is no faster gait."""
    pace = (len(walk.states) - 1) / (len(run.states) - 1)
    stride = speed / (commands.own_speed * pace)
    if pace < LEAST_FASTER or stride < LEAST_FASTER:
        raise BadFileError(
            f"{run.path}: {pace:.2g} laps in the time of one of {walk.path.name}, each {stride:.2g} times as long; wanted a "
            "faster gait, with quicker and longer strides."
        )
    return pace, stride


def _by_clock_of(
    lap: Float[np.ndarray, "L S"],
    run: Float[np.ndarray, "R S"],
    pace: float,
    positions: int,
    entries: GaitEntries,
) -> Float[np.ndarray, "L S"]:
    """Return a run resampled to the walk's clock: `L` states, velocities divided by `pace`, aligned where legs are most alike."""
    count = len(lap)
    times = np.arange(count) * (len(run) / count)
    closed = np.concatenate([run, run[:1]])
    states = np.stack(
        [np.interp(times, np.arange(len(closed)), column) for column in closed.T], axis=1
    )
    states[:, positions:] /= pace
    hinges = list(entries.hinges)
    off = [
        ((np.roll(states[:, hinges], shift, axis=0) - lap[:, hinges]) ** 2).sum()
        for shift in range(count)
    ]
    states = np.roll(states, int(np.argmin(off)), axis=0)
    states[:, ORIENTATION] = of_unit_length(states[:, ORIENTATION])
    for entry in (entries.clock.position_entry, entries.clock.velocity_entry):
        states[:, entry] = lap[:, entry]
    return states


def _speed(gait: GaitClip, lap: Float[np.ndarray, "L S"], velocity: int) -> float:
    """Return the mean speed of a lap along its heading [m/s]; BadFileError if it goes nowhere."""
    speed = float(lap[:, velocity].mean())
    if speed < MIN_SPEED:
        raise BadFileError(
            f"{gait.path}: the root moves at {speed:.2g} m/s; wanted at least {MIN_SPEED:g} m/s, for a speed that can be "
            "commanded."
        )
    return speed


def _standing(body: MujocoSystem) -> Float[np.ndarray, " S"]:
    """Return the body's rest state, at the origin with heading zero."""
    rest = np.array(body.rest, float)
    back = facing(-heading_of(rest[ORIENTATION]))
    rest[:2] = 0
    rest[ORIENTATION] = multiply(back, rest[ORIENTATION])
    return rest


def _from_heading(gait: GaitClip, entries: GaitEntries, dt: float) -> Float[np.ndarray, "L S"]:
    """Return the states of a lap without its last, with the root moved to the origin and rotated to go along X.

    The subtracted heading turns at a constant rate through the lap, by the motion's total turn; in the middle it points along
    the displacement of the lap.
    """
    states = gait.states
    count = len(states) - 1
    first = states[0, ORIENTATION]
    last = states[-1, ORIENTATION]
    turned = heading_of(last) - heading_of(first)
    turned = (turned + np.pi) % TURN - np.pi
    leads = states[-1, POSITION] - states[0, POSITION]
    headings = np.arctan2(leads[1], leads[0]) + turned * (np.arange(count) / count - 0.5)
    back = facing(-headings)
    lap = states[:-1].copy()
    lap[:, :2] = 0
    orientations = multiply(back, lap[:, ORIENTATION])
    lap[:, ORIENTATION] = orientations * np.sign(orientations[:, :1])
    velocity = entries.velocity
    moving = slice(velocity, velocity + 3)
    lap[:, moving] = rotate(back, lap[:, moving])
    spinning = slice(velocity + 3, velocity + 6)
    lap[:, spinning] -= turned / (count * dt) * upward(orientations)
    return lap
