"""Motions whose movers follow recorded paths: the path gives their positions, its velocities are the controls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.motion import STEP_ROUNDING, Drive
from neuroanimator.animation.recorded_path import RecordedPath, headings_of, read_path
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.state.mover_poses import Mover, change_between, moved, moved_as_one
from neuroanimator.state.rotation import (
    NO_ROTATION,
    conjugate,
    multiply,
    upward,
)
from neuroanimator.text import did_you_mean, listed, quoted

AXES = "xyz"
"""Axes of a position."""

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
class Follower:
    """A mover and its poses, one per super step."""

    name: str
    mover: Mover
    poses: Float[np.ndarray, "F D"]
    """Positions [m], and headings [rad] or quaternions if it turns."""

    def rates(self, dt: float) -> Float[np.ndarray, "T R"]:
        """Return the velocities that lead from each pose to the next [m/s], and turning rates [rad/s]."""
        return change_between(self.poses[:-1], self.poses[1:], self.mover.own_quaternions) / dt


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
        follower, remark = _follower(emulator, name, movers[name], path, times)
        remarks += remark
        remarks += _remarks_on_speed(emulator, follower, path, speed)
        followers.append(follower)
    controls = np.repeat(emulator.bounds.idle[None], len(times) - 1, axis=0)
    for follower in followers:
        controls[:, follower.mover.rates] = follower.rates(emulator.dt)
    return Drive(_start(emulator, followers), controls, tuple(remarks))


def movers_of(emulator: Emulator) -> dict[str, Mover]:
    """Return the movers of a soft body by name; other systems have none."""
    contacts = emulator.frame.shape_contacts
    if contacts is None:
        return {}
    states = {part.name for part in emulator.state.slices}
    names = [part.name for part in emulator.control.slices if part.name in states]
    return dict(zip(names, contacts.movers, strict=True))


def _check_mover(emulator: Emulator, movers: Mapping[str, Mover], name: str) -> None:
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
    emulator: Emulator,
    name: str,
    mover: Mover,
    path: RecordedPath,
    times: Float[np.ndarray, " F"],
) -> tuple[Follower, list[str]]:
    """Return the follower of a path, and remarks on rotations that it cannot follow."""
    follower = Follower(name, mover, path.poses(mover, emulator.rest[mover.entries], times))
    _, orientations = path.at(times)
    if orientations is None or mover.turns_freely:
        return follower, []
    what, lost, does, key = "turns", np.ptp(headings_of(orientations)), "does not", "true"
    if mover.turns:
        tilts = np.arccos(np.clip(upward(orientations)[:, 2], -1, 1))
        what, lost, does, key = "tilts", tilts.max(), "turns about the vertical only", '"freely"'
    if lost <= TURNS:
        return follower, []
    return follower, [
        f"{path.name}: it {what} by {np.rad2deg(lost):.0f} degrees, but {name} {does}, so that is ignored. To keep it, set "
        f"'turns = {key}' of {name} in the TOML file and train again."
    ]


def _remarks_on_speed(
    emulator: Emulator, follower: Follower, path: RecordedPath, speed: float
) -> list[str]:
    """Return remarks on a path that is faster than training; BadFileError if it cannot be followed."""
    mover = follower.mover
    rates = follower.rates(emulator.dt)
    low = np.array(emulator.bounds.low)[mover.rates]
    high = np.array(emulator.bounds.high)[mover.rates]
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
            f"{path.name}: {follower.name} would move {told}, {factor:.3g} times as fast as in training. Look for jumps, and for "
            "other units than metres."
        )
    if factor <= SLACK:
        return []
    slower = np.floor(100 * SLACK * speed / factor) / 100
    return [
        f"{path.name}: {follower.name} moves {told}, {factor:.3g} times as fast as in training, beyond what the emulator "
        f"knows. Slow it down (--path-speed {slower:g}), or raise '{bound}' of {follower.name} in the TOML file and train again."
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
        mover = follower.mover
        if mover.entry == anchor:
            back = -duration / 2 * follower.rates(emulator.dt)[0]
            begin = moved(follower.poses[0], back, mover.own_quaternions)
            _carry(start, movers_of(emulator), mover, begin)
    controls = np.repeat(emulator.bounds.idle[None], steps, axis=0)
    share = np.linspace(0, 1, steps + 1)[:, None]
    for follower in followers:
        mover = follower.mover
        rate = follower.rates(emulator.dt)[0]
        rest = start[mover.entries]
        way = change_between(rest, follower.poses[0], mover.own_quaternions)
        shift = (3 * share**2 - 2 * share**3) * way + (share**3 - share**2) * duration * rate
        poses = np.broadcast_to(rest, (steps + 1, len(rest)))
        coming = replace(follower, poses=moved(poses, shift, mover.own_quaternions))
        controls[:, mover.rates] = coming.rates(emulator.dt)
    return start, controls


def _carry(
    state: Float[np.ndarray, " S"],
    movers: Mapping[str, Mover],
    anchor: Mover,
    pose: Float[np.ndarray, " D"],
) -> None:
    """Move the mover that holds the body to a pose in `state`, and everything else with it as one rigid piece."""
    before = state.copy()
    state[anchor.entries] = pose
    old, new = (anchor.placement.quaternions(poses) for poses in (before, state))
    turn = np.array(NO_ROTATION) if old is None or new is None else multiply(new, conjugate(old))
    places = tuple(movers.values())
    about = anchor.placement.origin(before)
    size = places[-1].entries.stop
    state[:size] = moved_as_one(before[:size], places, turn, about, pose[: len(AXES)])
    state[anchor.entries] = pose  # with its whole turns
