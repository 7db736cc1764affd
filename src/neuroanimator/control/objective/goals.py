"""Goals of a system as cost terms and as verdicts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.costs import effort
from neuroanimator.control.objective.objective import (
    AT_THE_END,
    Moments,
    Objective,
    TimedTerm,
)
from neuroanimator.definitions.parts import GoalTable
from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.rotation import wrapped
from neuroanimator.state.segments import Plain, place_segments
from neuroanimator.systems.goal import Goal
from neuroanimator.systems.system import System
from neuroanimator.text import did_you_mean

ERRORS_PER_TOLERANCE = 3
"""Error of a cost per tolerance of its goal: a third of the tolerance is an error of one, to end well within it."""


class ReachState(TimedTerm):
    """Term for a state, or part of one, relative to the goal: for a parking bay, lengthwise and sideways."""

    frame: Frame
    goal: Float[AnyArray, " S"]
    judged: Float[AnyArray, "R V"]
    """Matrix that maps the difference from the goal to numbers where one is a sizeable error."""

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B R"]:
        xp = state.__array_namespace__()
        goal = xp.broadcast_to(xp.asarray(self.goal), state.shape)
        return self.frame.difference(goal, state) @ self.judged.T

    def compare(self, observed: Float[AnyArray, "K O"], dt: float) -> Float[AnyArray, " R"]:
        return self.when.share(dt) * observed.ravel()


def goal(
    system: System,
    name: str,
    *,
    at: float | tuple[float, ...] | None = None,
    since: float | None = None,
    weight: float = 1.0,
) -> ReachState:
    """Return the cost of not being at the system's goal `name` at the end, at times `at` [s], or from `since` [s] on.

    Raises ArgumentError with the names of the system's goals.
    """
    return reach_goal(system, find_goal(system, name), when=Moments.of(at, since), weight=weight)


def reach_state(
    system: System,
    reach: Mapping[str, Sequence[float]],
    *,
    within: Mapping[str, float] | None = None,
    at: float | None = None,
    since: float | None = None,
    weight: float = 1.0,
) -> ReachState:
    """Return the cost of parts of the state not having the values `reach` at the end, at `at` [s], or from `since` [s] on.

    `within` gives the tolerance of each part, in its unit; 0.1 by default.
    """
    wanted = state_goal(system, reach, within or {})
    return reach_goal(system, wanted, when=Moments.of(at, since), weight=weight)


def reach_goal(
    system: System, goal: Goal, *, when: Moments = AT_THE_END, weight: float = 1.0
) -> ReachState:
    """Return the cost of not being at a `goal` of `system`, at the end or at other moments; parts it does not name are free."""
    frame = Frame.of(system.structure, 0.0)
    rows, tolerances = judged_numbers(system, goal)
    if goal.scales:
        weights = 1 / np.array(goal.scales)
    else:
        weights = ERRORS_PER_TOLERANCE * (1 / tolerances)
    judged = weights[:, None] * rows
    return ReachState(
        weight=as_parameter(weight),
        when=when,
        frame=frame,
        goal=as_parameter(goal_state(system, goal)),
        judged=as_parameter(judged),
    )


def state_goal(
    system: System, reach: Mapping[str, Sequence[float]], within: Mapping[str, float]
) -> Goal:
    """Return the goal that parts of the state have the values `reach`, `within` given tolerances."""

    if not reach:
        raise ArgumentError("reach: wanted at least one part of the state and its values.")
    table = GoalTable.model_validate({"reach": reach, "within": within})
    return system.goal("reach_state", table)


def goal_objective(
    system: System, name: str, effort_weight: float = 1.0, since: float | None = None
) -> Objective:
    """Return the objective of being at the goal `name` at the end, or from `since` [s] on, with little effort.

    J = μ_u/2 ∫|u|² dt + μ_s/2 |s_{M+1} - s_d|², the seminar paper's eq. 11. Raises ArgumentError for a weight below 0.
    """
    if not 0 <= effort_weight < math.inf:
        raise ArgumentError(
            f"effort_weight: wanted a finite number of at least 0, got {effort_weight:g}."
        )
    return Objective.of(effort(effort_weight), goal(system, name, since=since))


def steps_in(seconds: float, dt: float, longest: float) -> int:
    """Return the number of super steps of `dt` [s] in `seconds`; ArgumentError for less than one, or more than `longest`."""
    if not dt <= seconds <= longest:
        raise ArgumentError(f"seconds: wanted between {dt:g} and {longest:g}, got {seconds:g}.")
    return round(seconds / dt)


def goal_state(system: System, goal: Goal) -> Float[np.ndarray, " S"]:
    """Return the state of rest with the goal's entries set."""
    target = np.array(system.rest, dtype=float)
    for entry, value in goal.values:
        target[entry] = value
    return target


def goal_start(system: System, name: str) -> Float[np.ndarray, " S"]:
    """Return the default start of motions to the goal called `name`."""
    goal = system.goals.get(name)
    if goal is None or not goal.start:
        return np.array(system.rest, float)
    return np.array(goal.start, float)


def is_reached(system: System, goal: Goal | str, state: ArrayLike) -> bool:
    """Return whether `state` (S,) is within the tolerances of `goal`, the name of one of the system's or any other goal."""
    if isinstance(goal, str):
        goal = find_goal(system, goal)
    return bool((np.abs(errors_over_tolerances(system, goal, state)) <= 1).all())


def errors_over_tolerances(system: System, goal: Goal, state: ArrayLike) -> Float[np.ndarray, " R"]:
    """Return the error of `state` (S,) in each of `judged_numbers`, over its tolerance."""
    frame = Frame.of(system.structure, 0.0)
    rows, tolerances = judged_numbers(system, goal)
    off = rows @ frame.difference(goal_state(system, goal), np.asarray(state, float))
    if goal.sums:
        is_angle = [row in system.structure.angles for row in goal.sums]
        nearest = wrapped(off)
        off = np.where(is_angle, nearest, off)
    return off * (1 / tolerances)


def judged_numbers(
    system: System, goal: Goal
) -> tuple[Float[np.ndarray, "R V"], Float[np.ndarray, " R"]]:
    """Return (rows that pick or sum the judged numbers of a difference of states, the tolerance of each)."""
    if goal.sums:
        return np.array(goal.sums, float), np.array(goal.tolerances, float)
    entries = _judged_entries(system, goal)
    numbers = [number for _, number, _ in entries]
    tolerances = np.array([tolerance for _, _, tolerance in entries])
    frame = Frame.of(system.structure, 0.0)
    return np.eye(frame.change_size(system.state.size))[numbers], tolerances


def judged_parts(system: System, goal: Goal) -> list[tuple[str, float]]:
    """Return the part of the state, such as `root.position`, and the tolerance of each of `judged_numbers`."""
    if goal.sums:
        parts = [_part_of(system, row.index(max(row, key=abs))) for row in goal.sums]
        return list(zip(parts, goal.tolerances, strict=True))
    entries = _judged_entries(system, goal)
    return [(_part_of(system, entry), tolerance) for entry, _, tolerance in entries]


def _part_of(system: System, entry: int) -> str:
    """Return the name of the part of the state that `entry` belongs to."""
    names = [part.name for part in system.state.slices for _ in range(part.size)]
    return names[entry]


def _judged_entries(system: System, goal: Goal) -> list[tuple[int, int, float]]:
    """Return (state entry, number of the difference, tolerance) for each entry that `goal` names; three for a quaternion.

    Raises ArgumentError for entries that follow the controls exactly: they are in no difference.
    """
    frame = Frame.of(system.structure, 0.0)
    wanted = {}
    for (entry, _), tolerance in zip(goal.values, goal.tolerances, strict=True):
        wanted[entry] = tolerance
    judged = []
    for placed in place_segments(frame.segments or (Plain(size=system.state.size),)):
        own = wanted.keys() & set(placed.indices)
        if own and not placed.segment.change_size:
            raise ArgumentError(
                f"goal: '{_part_of(system, min(own))}' follows the controls exactly, so it cannot be a goal. Name a part that "
                "moves by itself, or a node of the body (reach_node)."
            )
        for number in range(placed.segment.change_size):
            entry = placed.entries.start + number
            if entry in wanted:
                judged.append((entry, placed.changes.start + number, wanted[entry]))
    return judged


def find_goal(system: System, name: str) -> Goal:
    """Return the system's goal called `name`; ArgumentError lists the known names."""
    if name in system.goals:
        return system.goals[name]
    if not system.goals:
        raise ArgumentError(explain_costs(system))
    names = ", ".join(sorted(system.goals))
    like = did_you_mean(name, system.goals)
    raise ArgumentError(
        f"No goal called '{name}' for the system {system.name}. {like}Goals: {names}."
    )


def usual_goal(system: System) -> str:
    """Return the name of the only goal of `system`; ArgumentError if there is none, or several."""
    names = sorted(system.goals)
    if not names:
        raise ArgumentError(explain_costs(system))
    if len(names) > 1:
        raise ArgumentError(
            f"{system.name} has several goals. Say which: --goal {', --goal '.join(names)}."
        )
    return names[0]


def explain_costs(system: System) -> str:
    """Return one line on how to state a goal for a system that has none."""
    part = system.state.slices[0]
    values = ", ".join(["1.0"] * part.size)
    cost = f'[[costs]], kind = "reach_state", reach = {{ "{part.name}" = [{values}] }}'
    lines = f'system = "{system.name}", seconds = 2.0, {cost}'
    later = ""
    if system.definition_text:
        later = " Or add [goals.NAME] with such a reach to your TOML file, and pass --system FILE.toml --goal NAME."
    return f"Goals of {system.name}: none. Write a file my.toml with the lines {lines}; pass --objective my.toml.{later}"
