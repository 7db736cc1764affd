"""What controls do on the true physics, and whether a person would call it success."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator import ArgumentError, BadFileError, DivergedError, System, read_pose
from neuroanimator.authoring import short_number
from neuroanimator.control import Goal, errors_over_tolerances, find_goal, judged_parts
from neuroanimator_studio.descents import Verdict
from neuroanimator_studio.description import TARGET, place_within, root_entry
from neuroanimator_studio.drive import PushedDrive
from neuroanimator_studio.library import Shown
from neuroanimator_studio.limits import Limits


class Replayed(NamedTuple):
    """Controls on the true physics."""

    states: Float[np.ndarray, "K S"]
    """K = T+1 states, the start included."""
    wall_s: float
    """Time it took [s]."""
    usual_wall_s: float
    """Time the physics takes as a user would run it [s]: what speed-ups are measured against."""
    physics_steps: int
    """How many steps the usual physics makes in that time."""


def replay_physics(shown: Shown, drive: PushedDrive, limits: Limits) -> Replayed:
    """Return what `drive` does on the true physics.

    Raises ArgumentError for too long a motion, DivergedError where the physics blows up.
    """
    dt = shown.spec.dt
    system = shown.system
    if system.missing:
        raise BadFileError(system.missing)
    if not system.can_simulate:
        raise ArgumentError(
            f"{system.name} is known from recordings alone: there is no physics to replay on."
        )
    count = len(drive.controls)
    steps = count * system.truth.steps(dt)
    if steps > limits.physics_steps:
        raise ArgumentError(
            f"controls: wanted a motion of at most {limits.physics_steps:,} physics steps, got {steps:,}. Shorten it."
        )
    began = time.perf_counter()
    states = drive.played(lambda start, held: _simulated(system, start, held, dt))
    wall_s = time.perf_counter() - began
    began = time.perf_counter()
    drive.played(lambda start, held: _simulated(system, start, held, dt, is_usual=True))
    usual_wall_s = time.perf_counter() - began
    return Replayed(states, wall_s, usual_wall_s, count * system.scheme.steps(dt))


def _simulated(
    system: System,
    start: Float[np.ndarray, " S"],
    controls: Float[np.ndarray, "T C"],
    dt: float,
    *,
    is_usual: bool = False,
) -> Float[np.ndarray, "K S"]:
    scheme = system.scheme if is_usual else None
    runs = system.simulate_fastest(start[None], controls[None], dt, scheme=scheme)
    # The usual scheme is run for its time alone.
    if runs.has_diverged[0] and not is_usual:
        raise DivergedError(
            "The physics diverged under these controls. Shorten the motion, or make it milder."
        )
    return runs.states[0]


def judge(
    shown: Shown,
    goal_name: str,
    state: Float[np.ndarray, " S"],
    target: tuple[float, float, float] | None = None,
) -> Verdict:
    """Return how near `state` (S,), the last of a motion, is to a goal; `target` is where its place was dragged to [m]."""
    system = shown.system
    state = shown.spec.state.check(state, "states")
    if goal_name == TARGET and TARGET not in system.goals:
        return _judge_place(shown, state, target)
    goal = find_goal(system, goal_name)
    place = root_entry(system)
    if place is not None and target is not None:
        goal = _moved(goal, place, target)
    return _judge_goal(system, goal, state, place)


def _judge_place(
    shown: Shown, state: Float[np.ndarray, " S"], target: tuple[float, float, float] | None
) -> Verdict:
    if target is None:
        raise ArgumentError("target: wanted a place to be judged by.")
    with np.errstate(
        all="ignore"
    ):  # nobody asks where a body points whose points are all in one place
        position = np.asarray(read_pose(shown.system.structure, state).position)
    gap = float(np.linalg.norm(position - np.array(target)))
    within = place_within(shown.spec, shown.system)
    words = f"ends {short_number(gap)} m from the target; within {short_number(within)} m counts"
    return Verdict(gap <= within, gap, words)


def _moved(goal: Goal, place: int, target: tuple[float, float, float]) -> Goal:
    """Return `goal` with the position, which begins at the entry `place`, moved to `target`."""
    values = []
    for entry, value in goal.values:
        number = entry - place
        values.append((entry, target[number] if 0 <= number < 3 else value))
    return replace(goal, values=tuple(values))


def _judge_goal(
    system: System, goal: Goal, state: Float[np.ndarray, " S"], place: int | None
) -> Verdict:
    errors = np.abs(errors_over_tolerances(system, goal, state))
    worst = int(errors.argmax())
    part, tolerance = judged_parts(system, goal)[worst]
    is_success = bool(errors[worst] <= 1)
    gap = float(errors[worst])
    wanted = dict(goal.values)
    if place is not None and place in wanted:
        at = np.array([wanted.get(place + axis, state[place + axis]) for axis in range(3)])
        gap = float(np.linalg.norm(state[place : place + 3] - at))
    off = short_number(float(errors[worst]) * tolerance)
    words = f"{part} is off by {off}; {short_number(tolerance)} counts"
    return Verdict(is_success, gap, words)
