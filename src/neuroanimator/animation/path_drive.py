"""Motions whose movers follow recorded paths: the path's places are the movers', its velocities the controls."""

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
from neuroanimator.state.layout import Bounds
from neuroanimator.state.segments import Driven
from neuroanimator.text import did_you_mean, listed, quoted

SPEEDS = (0.01, 100.0)
"""Least and largest speed a path may be played at."""

MAX_FACTOR = 10.0
"""A path that is this many times as fast as training jumps, or is in other units: it is refused."""

SLACK = 1.01
"""A path that is faster than training by less is not told of: tables are rounded."""

RUN_IN = 0.5
"""Time in which movers take on the velocities that paths begin with [s], before what is shown."""

MAX_RUN_IN = 8.0
"""The same where a mover has far to go from where it rests to where its path begins [s]."""

TURNS = 0.35
"""Angle [rad] above which it is told that a mover does not turn with its path."""


@dataclass(frozen=True, eq=False)
class Follower:
    """A mover and the places it is to be at, one a super step."""

    name: str
    entries: slice
    """Its position in a state."""
    controls: slice
    """Its velocity in a control."""
    positions: Float[np.ndarray, "F 3"]
    """[m]"""

    def velocities(self, dt: float) -> Float[np.ndarray, "T 3"]:
        """Return the velocities that lead from each place to the next [m/s]."""
        return np.diff(self.positions, axis=0) / dt


def path_drive(
    emulator: Emulator,
    paths: Mapping[str, RecordedPath | str | Path],
    *,
    speed: float = 1.0,
    seconds: float | None = None,
) -> Drive:
    """Return the motion in which movers, by name, follow `paths`, played at `speed`; other movers stay.

    It lasts while all paths do, and at most `seconds`. The body, at rest, is carried to where the path of the mover that
    holds it begins, and from there movers take on their paths' first places and velocities, before the motion begins.
    A path is followed even where it is faster than training was; the drive's `remarks` say so.

    Raises ArgumentError for movers there are not, BadFileError for paths that cannot be followed.
    """
    if not paths:
        raise ArgumentError("path: wanted a mover and its path, came none.")
    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise ArgumentError(
            f"path-speed: wanted {SPEEDS[0]:g} to {SPEEDS[1]:g} times the path's, came {speed:g}."
        )
    recorded: dict[str, RecordedPath] = {}
    for name, path in paths.items():
        _check_mover(emulator, name)
        recorded[name] = path if isinstance(path, RecordedPath) else read_path(path)
    times = _times(recorded, emulator.dt, speed, seconds)
    followers = []
    remarks = []
    for name, path in recorded.items():
        positions, headings = path.at(times)
        follower = Follower(
            name, emulator.state.index(name), emulator.control.index(name), positions
        )
        remarks += _remarks(emulator, follower, path, headings, speed)
        followers.append(follower)
    controls = np.repeat(emulator.bounds.idle[None], len(times) - 1, axis=0)
    for follower in followers:
        controls[:, follower.controls] = follower.velocities(emulator.dt)
    return Drive(_start(emulator, followers), controls, tuple(remarks))


def movers_of(emulator: Emulator) -> list[str]:
    """Return the names of what the controls move as they say, by its velocity."""
    if not any(isinstance(segment, Driven) for segment in emulator.frame.segments):
        return []
    positions = [part.name for part in emulator.state.slices if part.unit == "m"]
    return [
        part.name
        for part in emulator.control.slices
        if part.size == 3 and part.unit == "m/s" and part.name in positions
    ]


def _check_mover(emulator: Emulator, name: str) -> None:
    movers = movers_of(emulator)
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
    """Return the paths' times at the ends of super steps [s], while all paths last."""
    begin = max(float(path.times[0]) for path in paths.values())
    end = min(float(path.times[-1]) for path in paths.values())
    steps = int((end - begin) / (speed * dt) + STEP_ROUNDING)
    if seconds is not None:
        if not seconds >= dt:
            raise ArgumentError(f"seconds: wanted at least {dt:g}, came {seconds:g}.")
        steps = min(steps, int(np.ceil(seconds / dt - STEP_ROUNDING)))
    if steps < 1:
        names = listed(path.name for path in paths.values())
        raise BadFileError(
            f"{names}: wanted at least {speed * dt:g} s that all paths have, came {max(end - begin, 0):g} s."
        )
    return begin + speed * dt * np.arange(steps + 1)


def _remarks(
    emulator: Emulator,
    follower: Follower,
    path: RecordedPath,
    headings: Float[np.ndarray, " F"] | None,
    speed: float,
) -> list[str]:
    """Return what is to be told of a path; BadFileError if it cannot be followed."""
    remarks = []
    name = follower.name
    velocities = follower.velocities(emulator.dt)
    factors = _factors(emulator.bounds, follower, velocities)
    step, axis = np.unravel_index(factors.argmax(), factors.shape)
    factor = float(factors[step, axis])
    fastest = abs(float(velocities[step, axis]))
    if factor > MAX_FACTOR:
        raise BadFileError(
            f"{path.name}: {name} would move at {fastest:.3g} m/s along {'xyz'[axis]}, {factor:.3g} times as fast as in "
            "training. Look for jumps, and for other units than metres."
        )
    if factor > SLACK:
        slower = np.floor(100 * speed / factor) / 100
        remarks.append(
            f"{path.name}: {name} moves at up to {fastest:.3g} m/s along {'xyz'[axis]}, {factor:.3g} times as fast as in "
            f"training, and is followed beyond what the emulator knows. Give --path-speed {slower:g}, or raise "
            f"'speed' of {name} in the TOML file and train again."
        )
    if headings is not None and np.ptp(headings) > TURNS:
        remarks.append(
            f"{path.name}: it turns by {np.rad2deg(np.ptp(headings)):.0f} degrees, but {name} only moves."
        )
    return remarks


def _factors(
    bounds: Bounds, follower: Follower, velocities: Float[np.ndarray, "F 3"]
) -> Float[np.ndarray, "F 3"]:
    """Return velocities over their bounds."""
    low = np.array(bounds.low)[follower.controls]
    high = np.array(bounds.high)[follower.controls]
    return np.maximum(velocities / high, velocities / low)


def _start(emulator: Emulator, followers: list[Follower]) -> Float[np.ndarray, " S"]:
    """Return the state in which all `followers` are at their first places, with their first velocities."""
    steps = max(round(RUN_IN / emulator.dt), 1)
    while True:
        start, controls = _run_in(emulator, followers, steps)
        is_too_fast = not emulator.bounds.contain(controls)
        if not is_too_fast or 2 * steps * emulator.dt > MAX_RUN_IN:
            break
        steps *= 2
    state = np.asarray(emulator.rollout(start, controls), float)[-1]
    for follower in followers:
        state[follower.entries] = follower.positions[0]
    return state


def _run_in(
    emulator: Emulator, followers: list[Follower], steps: int
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, "T C"]]:
    """Return a state of rest, and controls that bring `followers` to where their paths begin.

    A mover that holds the body begins where constant acceleration brings it there; the others where they rest beside it.
    """
    duration = steps * emulator.dt
    start = emulator.rest
    shapes = emulator.skeleton.shapes
    anchor = -1 if shapes is None else shapes.anchor
    for follower in followers:
        if follower.entries.start == anchor:
            velocity = follower.velocities(emulator.dt)[0]
            carried = follower.positions[0] - duration / 2 * velocity - start[follower.entries]
            for name in movers_of(emulator):
                start[emulator.state.index(name)] += carried
    controls = np.repeat(emulator.bounds.idle[None], steps, axis=0)
    share = np.linspace(0, 1, steps + 1)[:, None]
    for follower in followers:
        velocity = follower.velocities(emulator.dt)[0]
        way = follower.positions[0] - start[follower.entries]
        places = (3 * share**2 - 2 * share**3) * way + (share**3 - share**2) * duration * velocity
        controls[:, follower.controls] = np.diff(places, axis=0) / emulator.dt
    return start, controls
