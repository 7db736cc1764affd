"""What controls do on the true physics, and whether a person would call it success."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.control.objective.goals import errors_over_tolerances, find_goal, judged_parts
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.errors import ArgumentError, DivergedError
from neuroanimator.state.pose import read_pose
from neuroanimator.state.segments import Position, first_of_each, moves_freely
from neuroanimator.studio.descents import Verdict
from neuroanimator.studio.description import TARGET, place_within
from neuroanimator.studio.library import Shown
from neuroanimator.studio.limits import Limits
from neuroanimator.systems.goal import Goal
from neuroanimator.systems.system import System
from neuroanimator.text import short_number


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


def replay_physics(
    shown: Shown, start: Sequence[float], controls: Sequence[Sequence[float]], limits: Limits
) -> Replayed:
    """Return what `controls` (T, C) do from `start` (S,) on the true physics.

    Raises ArgumentError for a wrong shape, controls out of bounds and too long a motion, DivergedError where the physics
    blows up.
    """
    spec = shown.spec
    system = shown.system
    if not system.can_simulate:
        raise ArgumentError(
            f"{system.name} is known from recordings alone: there is no physics to replay on."
        )
    state = spec.state.check(start, "start")
    held = checked_controls(spec, controls, limits)
    steps = len(held) * system.truth.steps(spec.dt)
    if steps > limits.physics_steps:
        raise ArgumentError(
            f"controls: wanted a motion of at most {limits.physics_steps:,} physics steps, came {steps:,}. Shorten it."
        )
    began = time.perf_counter()
    runs = system.simulate_fastest(state[None], held[None], spec.dt)
    wall_s = time.perf_counter() - began
    if runs.has_diverged[0]:
        raise DivergedError(
            "The physics diverged under these controls. Shorten the motion, or make it milder."
        )
    began = time.perf_counter()
    system.simulate_fastest(state[None], held[None], spec.dt, scheme=system.scheme)
    usual_wall_s = time.perf_counter() - began
    usual_steps = len(held) * system.scheme.steps(spec.dt)
    return Replayed(runs.states[0], wall_s, usual_wall_s, usual_steps)


def checked_controls(
    spec: EmulatorSpec, controls: Sequence[Sequence[float]], limits: Limits
) -> Float[np.ndarray, "T C"]:
    """Return `controls` as an array; ArgumentError unless they are finite, within bounds and not too many."""
    if not 1 <= len(controls) <= limits.steps:
        raise ArgumentError(
            f"controls: wanted 1 to {limits.steps:,} super steps, came {len(controls):,}."
        )
    rows = spec.control.check(controls, "controls")
    spec.bounds.check(rows, spec.control.names)
    # What the page brings to a bound in float32 may be one rounding beyond it.
    return spec.bounds.clip(rows)


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
    place = None
    if moves_freely(system.structure.segments):
        entries = first_of_each(system.structure.segments)[Position].entries
        place = entries.start
        if target is not None:
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
