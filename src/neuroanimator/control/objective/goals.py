"""Goals a system itself names, as objectives and as verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from neuroanimator.control.objective.costs import effort
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.terms import END, ReachState
from neuroanimator.errors import ArgumentError
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.segments import Plain, place_segments
from neuroanimator.state.structure import Structure
from neuroanimator.systems.goal import Goal
from neuroanimator.systems.system import System

Verdict = Callable[[np.ndarray], bool]
"""Whether a state (S,) fulfils a goal."""

UPRIGHT_ANGLE = 0.1
"""[rad] An angle error that counts as one: a third of the 10° that still count as upright."""
UPRIGHT_SPEED = 0.5
"""[rad/s] A speed error that counts as one: half of what still counts as at rest."""
UPRIGHT_WITHIN = np.deg2rad(10.0)
"""[rad] Each link may lean this much and still count as upright."""
STILL_WITHIN = 1.0
"""[rad/s] Each link may turn this fast and still count as still."""
SWING_SECONDS = 1.5
"""As long as a quick human arm takes; the motors could do it in one."""


def stand_upright(
    effort_weight: float = 1.0, state_weight: float = 1.0, times: tuple[float, ...] = END
) -> Objective:
    """Return the objective 'all three links of the pendulum point up and stand still' at the end or at `times` [s].

    J = μ_u/2 ∫|u|² dt + μ_s/2 |s_{M+1} - s_d|², the seminar paper's eq. 11.
    """
    sums = np.tril(np.ones((3, 3)))
    zeros = np.zeros((3, 3))
    compare = np.block([[sums / UPRIGHT_ANGLE, zeros], [zeros, sums / UPRIGHT_SPEED]])
    goal = np.array([math.pi, 0.0, 0.0, 0.0, 0.0, 0.0])
    return Objective.of(
        effort(effort_weight), ReachState.of(Frame((), (), 0.0), goal, compare, state_weight, times)
    )


def reach_state(
    structure: Structure,
    rest: np.ndarray,
    goal: Goal,
    effort_weight: float = 1.0,
    state_weight: float = 1.0,
) -> Objective:
    """Return the objective 'be in the state `goal` names at the end'; entries it does not name are free."""
    return Objective.of(effort(effort_weight), reach_goal(structure, rest, goal, state_weight))


def reach_goal(
    structure: Structure,
    rest: np.ndarray,
    goal: Goal,
    weight: float = 1.0,
    times: tuple[float, ...] = END,
) -> ReachState:
    """Return the wish of `reach_state` alone. A third of a goal's tolerance counts as an error of one."""
    frame = Frame.of(structure, 0.0)
    weights = 3 * tangent_weights(frame, len(rest), goal)
    return ReachState.of(
        frame, goal_state(rest, goal), np.diag(weights)[weights > 0], weight, times
    )


def goal_state(rest: np.ndarray, goal: Goal) -> np.ndarray:
    """Return `rest` (S,) with the goal's entries in their places."""
    target = np.array(rest, dtype=float)
    for entry, value in goal.values:
        target[entry] = value
    return target


def tangent_weights(frame: Frame, size: int, goal: Goal) -> np.ndarray:
    """Return (V,) one over the goal's tolerance for each number of a change; zero where anything will do."""
    wanted = {
        entry: tolerance for (entry, _), tolerance in zip(goal.values, goal.tolerances, strict=True)
    }
    weights = []
    for placed in place_segments(frame.segments or (Plain(size=size),)):
        first = placed.entries.start
        entries = range(first, first + placed.segment.change_size)
        weights += [1 / wanted[entry] if entry in wanted else 0.0 for entry in entries]
    return np.array(weights)


def is_reached(system: System, goal: Goal, state: np.ndarray) -> bool:
    """Return whether `state` (S,) is within the tolerances of `goal`."""
    frame = Frame.of(system.structure, 0.0)
    off = frame.difference(goal_state(system.rest, goal), state) * tangent_weights(
        frame, len(state), goal
    )
    return bool((np.abs(off) <= 1).all())


def is_upright(state: np.ndarray) -> bool:
    """Return whether all three links of the pendulum in `state` (6,) point up and are nearly still."""
    lean = np.cumsum(state[:3]) - np.pi
    lean = (lean + np.pi) % (2 * np.pi) - np.pi
    return bool(
        (np.abs(lean) < UPRIGHT_WITHIN).all()
        and (np.abs(np.cumsum(state[3:])) < STILL_WITHIN).all()
    )


def goal_start(system: System, name: str) -> np.ndarray:
    """Return the state (S,) the goal called `name` is to be reached from, if nothing else is said."""
    goal = system.goals.get(name)
    return np.array(goal.start if goal and goal.start else system.rest, float)


GOALS = {"upright": stand_upright}


def find_goal(
    system: System, name: str, effort_weight: float = 1.0
) -> tuple[Objective, Verdict, float]:
    """Return (objective, verdict, usual length [s]) of the system's goal called `name`."""
    if system.name == "pendulum" and name in GOALS:
        return GOALS[name](effort_weight=effort_weight), is_upright, SWING_SECONDS
    if name in system.goals:
        goal = system.goals[name]
        objective = reach_state(system.structure, system.rest, goal, effort_weight)
        return objective, lambda state: is_reached(system, goal, state), goal.seconds
    names = goal_names(system)
    if not names:
        raise ArgumentError(how_to_wish(system))
    raise ArgumentError(
        f"No goal called '{name}' for the system {system.name}. Goals: {', '.join(names)}."
    )


def goal_names(system: System) -> list[str]:
    """Return the names of the goals `find_goal` knows for `system`."""
    return sorted([*system.goals, *(GOALS if system.name == "pendulum" else ())])


def usual_goal(system: System) -> str:
    """Return the one goal of `system`; ArgumentError where there is none, or a choice."""
    names = goal_names(system)
    if not names:
        raise ArgumentError(how_to_wish(system))
    if len(names) > 1:
        raise ArgumentError(
            f"{system.name} has several goals. Say which: --goal {', --goal '.join(names)}."
        )
    return names[0]


def how_to_wish(system: System) -> str:
    """Return one line on how to ask something of a system that names no goals."""
    part = system.state.slices[0]
    values = ", ".join(["1.0"] * part.size)
    wish = f'[[costs]], kind = "reach_state", reach = {{ "{part.name}" = [{values}] }}'
    lines = f'system = "{system.name}", seconds = 2.0, {wish}'
    later = ""
    if system.definition_text:
        later = " Or add [goals.NAME] with such a reach to your TOML file, and pass --system FILE.toml --goal NAME."
    return f"Goals of {system.name}: none. Write a file my.toml with the lines {lines}; pass --objective my.toml.{later}"
