"""Motions whose movers follow recorded paths: the path gives their positions, its velocities are the controls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.motion import STEP_ROUNDING, Drive
from neuroanimator.animation.recorded_path import RecordedPath, read_path
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.state.rotation import facing, rotate
from neuroanimator.state.segments import Driven
from neuroanimator.text import did_you_mean, listed, quoted

AXES = "xyz"
"""Axes of a position."""

TURNING = "_turning"
"""Suffix of a mover's turning rate in the control, if it turns."""

SPEEDS = (0.01, 100.0)
"""Minimum and maximum playback speed of a path."""

MAX_FACTOR = 10.0
"""Maximum speed of a path as a multiple of training's; a faster one has jumps, or other units, and is refused."""

SLACK = 1.01
"""Ratio of a path's speed to training's up to which there is no remark: tables are rounded."""

RUN_IN = 0.5
"""Time before the motion shown in which movers take on their paths' initial velocities [s]."""

MAX_RUN_IN = 8.0
"""Maximum of that time, for a mover that rests far from where its path begins [s]."""

TURNS = 0.35
"""Angle above which a remark says that a mover does not turn with its path [rad]."""


@dataclass(frozen=True, eq=False)
class DrivenMover:
    """A thing that the controls move by its velocity, and by its turning rate if it turns."""

    name: str
    entries: list[int]
    """State entries of its position [m], and of its heading [rad] if it turns; the same entries of a control are their rates."""

    @property
    def turns(self) -> bool:
        """Whether the mover has a heading."""
        return len(self.entries) > len(AXES)


@dataclass(frozen=True, eq=False)
class Follower:
    """A mover and its poses, one per super step."""

    mover: DrivenMover
    poses: Float[np.ndarray, "F D"]
    """Positions [m], and headings [rad] if it turns."""

    def rates(self, dt: float) -> Float[np.ndarray, "T D"]:
        """Return the velocities that lead from each pose to the next [m/s], and turning rates [rad/s]."""
        return np.diff(self.poses, axis=0) / dt


def path_drive(
    emulator: Emulator,
    paths: Mapping[str, RecordedPath | str | Path],
    *,
    speed: float = 1.0,
    seconds: float | None = None,
) -> Drive:
    """Return the motion in which movers, by name, follow `paths` played at `speed`; other movers stay.

    It ends with the shortest path, or after `seconds`. Before it begins, the body, at rest, is carried to where the path of
    the mover that holds it begins, and the movers take on the initial positions and velocities of their paths.
    A path is followed even where it is faster than in training; the drive's `remarks` say so.

    Raises ArgumentError for unknown movers, BadFileError for paths that cannot be followed.
    """
    if not paths:
        raise ArgumentError("path: wanted a mover and its path, got none.")
    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise ArgumentError(
            f"path-speed: wanted {SPEEDS[0]:g} to {SPEEDS[1]:g} times the path's, got {speed:g}."
        )
    movers = movers_of(emulator)
    recorded: dict[str, RecordedPath] = {}
    for name, path in paths.items():
        _check_mover(emulator, movers, name)
        recorded[name] = path if isinstance(path, RecordedPath) else read_path(path)
    times = _times(recorded, emulator.dt, speed, seconds)
    followers = []
    remarks = []
    for name, path in recorded.items():
        follower, remark = _follower(emulator, movers[name], path, times)
        remarks += remark
        remarks += _remarks_on_speed(emulator, follower, path, speed)
        followers.append(follower)
    controls = np.repeat(emulator.bounds.idle[None], len(times) - 1, axis=0)
    for follower in followers:
        controls[:, follower.mover.entries] = follower.rates(emulator.dt)
    return Drive(_start(emulator, followers), controls, tuple(remarks))


def movers_of(emulator: Emulator) -> dict[str, DrivenMover]:
    """Return the movers of a soft body by name; other systems have none."""
    if not any(isinstance(segment, Driven) for segment in emulator.frame.segments):
        return {}
    movers = {}
    states = {part.name for part in emulator.state.slices}
    controls = {part.name for part in emulator.control.slices}
    for part in emulator.control.slices:
        if part.name in states and part.size == len(AXES):
            # Poses of movers come first in a state, as their rates do in a control.
            first = emulator.control.index(part.name).start
            count = len(AXES) + (f"{part.name}{TURNING}" in controls)
            movers[part.name] = DrivenMover(part.name, list(range(first, first + count)))
    return movers


def _check_mover(emulator: Emulator, movers: Mapping[str, DrivenMover], name: str) -> None:
    if not movers:
        raise ArgumentError(
            f"path: {emulator.system} has no movers, only soft bodies have. Give --controls instead."
        )
    if name not in movers:
        raise ArgumentError(
            f"path: no mover called {quoted(name)}. {did_you_mean(name, movers)}Movers: {listed(movers)}."
        )


def _times(
    paths: Mapping[str, RecordedPath], dt: float, speed: float, seconds: float | None
) -> Float[np.ndarray, " F"]:
    """Return the times on the paths at the ends of super steps [s], as long as all paths last."""
    begin = max(float(path.times[0]) for path in paths.values())
    end = min(float(path.times[-1]) for path in paths.values())
    steps = int((end - begin) / (speed * dt) + STEP_ROUNDING)
    if seconds is not None:
        if not seconds >= dt:
            raise ArgumentError(f"seconds: wanted at least {dt:g}, got {seconds:g}.")
        steps = min(steps, int(np.ceil(seconds / dt - STEP_ROUNDING)))
    if steps < 1:
        names = listed(path.name for path in paths.values())
        raise BadFileError(
            f"{names}: wanted at least {speed * dt:g} s that all paths have, got {max(end - begin, 0):g} s."
        )
    return begin + speed * dt * np.arange(steps + 1)


def _follower(
    emulator: Emulator, mover: DrivenMover, path: RecordedPath, times: Float[np.ndarray, " F"]
) -> tuple[Follower, list[str]]:
    """Return the follower of a path, and remarks on its headings."""
    positions, headings = path.at(times)
    if mover.turns:
        if headings is None:
            headings = np.full(len(times), emulator.rest[mover.entries[-1]])
        return Follower(mover, np.concatenate([positions, headings[:, None]], axis=1)), []
    remarks = []
    if headings is not None and np.ptp(headings) > TURNS:
        angle = np.rad2deg(np.ptp(headings))
        remarks.append(
            f"{path.name}: it turns by {angle:.0f} degrees, but {mover.name} does not, so the turn is ignored. To keep it, set "
            f"'turns = true' of {mover.name} in the TOML file and train again."
        )
    return Follower(mover, positions), remarks


def _remarks_on_speed(
    emulator: Emulator, follower: Follower, path: RecordedPath, speed: float
) -> list[str]:
    """Return remarks on a path that is faster than training; BadFileError if it cannot be followed."""
    mover = follower.mover
    rates = follower.rates(emulator.dt)
    low = np.array(emulator.bounds.low)[mover.entries]
    high = np.array(emulator.bounds.high)[mover.entries]
    factors = np.maximum(rates / high, rates / low)
    step, axis = np.unravel_index(factors.argmax(), factors.shape)
    factor = float(factors[step, axis])
    fastest = abs(float(rates[step, axis]))
    if axis < len(AXES):
        told = f"at up to {fastest:.3g} m/s along {AXES[axis]}"
        bound = "speed"
    else:
        told = f"and turns at up to {fastest:.3g} rad/s"
        bound = "turn_speed"
    if factor > MAX_FACTOR:
        raise BadFileError(
            f"{path.name}: {mover.name} would move {told}, {factor:.3g} times as fast as in training. Look for jumps, and for "
            "other units than metres."
        )
    if factor <= SLACK:
        return []
    slower = np.floor(100 * SLACK * speed / factor) / 100
    return [
        f"{path.name}: {mover.name} moves {told}, {factor:.3g} times as fast as in training, beyond what the emulator "
        f"knows. Give --path-speed {slower:g}, or raise '{bound}' of {mover.name} in the TOML file and train again."
    ]


def _start(emulator: Emulator, followers: list[Follower]) -> Float[np.ndarray, " S"]:
    """Return the state in which all `followers` have their initial poses and velocities."""
    steps = max(round(RUN_IN / emulator.dt), 1)
    while True:
        start, controls = _run_in(emulator, followers, steps)
        is_slow_enough = emulator.bounds.contain(controls)
        if is_slow_enough or 2 * steps * emulator.dt > MAX_RUN_IN:
            break
        steps *= 2
    state = np.asarray(emulator.rollout(start, controls), float)[-1]
    for follower in followers:
        state[follower.mover.entries] = follower.poses[0]
    return state


def _run_in(
    emulator: Emulator, followers: list[Follower], steps: int
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, "T C"]]:
    """Return a state of rest, and controls that bring `followers` to the beginnings of their paths.

    A mover that holds the body starts where constant acceleration takes it there; the others start at their rest poses beside it.
    """
    duration = steps * emulator.dt
    start = emulator.rest
    shapes = emulator.skeleton.shapes
    anchor = -1 if shapes is None else shapes.placement.position
    for follower in followers:
        if follower.mover.entries[0] == anchor:
            begin = follower.poses[0] - duration / 2 * follower.rates(emulator.dt)[0]
            _carry(start, movers_of(emulator), follower.mover, begin)
    controls = np.repeat(emulator.bounds.idle[None], steps, axis=0)
    share = np.linspace(0, 1, steps + 1)[:, None]
    for follower in followers:
        rate = follower.rates(emulator.dt)[0]
        way = follower.poses[0] - start[follower.mover.entries]
        poses = (3 * share**2 - 2 * share**3) * way + (share**3 - share**2) * duration * rate
        controls[:, follower.mover.entries] = np.diff(poses, axis=0) / emulator.dt
    return start, controls


def _carry(
    state: Float[np.ndarray, " S"],
    movers: Mapping[str, DrivenMover],
    anchor: DrivenMover,
    pose: Float[np.ndarray, " D"],
) -> None:
    """Move the mover that holds the body to a pose in `state`, and everything else with it as one rigid piece."""
    before = state[anchor.entries]
    turned = float((pose - before)[len(AXES) :].sum())
    for mover in movers.values():
        position = mover.entries[: len(AXES)]
        away = state[position] - before[: len(AXES)]
        state[position] = pose[: len(AXES)] + rotate(facing(np.float64(turned)), away)
        if mover.turns:
            state[mover.entries[-1]] += turned
