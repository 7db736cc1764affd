"""What the page can look for with each system: a descent whose target may be dragged, and when the physics has done it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator import (
    ArgumentError,
    DescentOptions,
    Emulator,
    Objective,
    System,
    avoid,
    effort,
    goal,
    is_reached,
    reach_position,
    read_pose,
    smoothness,
    stay_upright,
)
from neuroanimator.authoring import SHIPPED_SYSTEMS, MujocoSystem, emulator_name
from neuroanimator.control import (
    EachStep,
    Goal,
    Parametrisation,
    Spline,
    Steered,
    first_guesses,
    goal_start,
    goal_state,
    pose_problem,
)
from neuroanimator.learn.tasks import (
    FINAL_DESCENT_SECONDS,
    HOLD_SECONDS,
    HOLD_STRIDE,
    PAD_RADIUS,
    ROLL_WITHIN,
    TRUCK_AVOIDANCE,
    TRUCK_MARGIN,
    TRUCK_PROBES,
    body_length,
    clearance,
    ends_upright,
    gait_controls,
    is_soft_landing,
    landing_objective,
    lot_zones,
    steps_of_a_period,
)
from neuroanimator_studio.descent_module import Movable, PageDescent, Write, entries_of
from neuroanimator_studio.description import TARGET_WITHIN

Values = Mapping[str, Sequence[float]]
"""What may be moved and where it was moved to, by name."""


class Verdict(NamedTuple):
    """Whether a motion of the physics has done what was asked."""

    is_success: bool
    gap: float
    """How far off it ends [m], or [rad] where nothing has a place."""
    words: str
    """One line for people."""


@dataclass(frozen=True)
class Swimming:
    """How a swimmer is steered to a place."""

    seconds: float
    """Long enough to see it go there, and short enough for the emulator to be right about it."""
    target: tuple[float, float, float]
    """Where the target is at first: ahead, to the left and above, over the length of the body."""
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    """Between these the target may be dragged: what it comes to in the time."""


SWIMMING = {
    "fish": Swimming(5.0, (1.3, 0.5, 0.0), (0.6, -0.8, -0.3), (1.8, 0.8, 0.3)),
    "dolphin": Swimming(3.0, (2.4, 0.6, 0.1), (1.2, -1.2, -0.4), (3.6, 1.2, 0.2)),
}

STEERING_KNOTS = 6
"""Of the splines by which a swimmer's gait is steered."""

FIRST_STRENGTH = 0.7
"""First guesses are the gait at this strength: at full strength its muscles are at their bounds."""

SIZEABLE = 0.1
"""Distance, over the length of the body, that is an error of one in the cost."""


def swim_to_a_place(system: System, emulator: Emulator) -> PageDescent:
    """Return the descent of a swimmer from rest to a place, back up."""
    swimming = SWIMMING[system.name]
    steps = round(swimming.seconds / emulator.dt)
    assert system.gait is not None
    length = body_length(system)
    start = np.array(system.rest, float)
    origin = read_pose(system.structure, start).position
    place = origin + length * np.array(swimming.target)
    objective = Objective.of(
        effort(0.1),
        smoothness(0.001),
        stay_upright(system),
        reach_position(system, place, within=SIZEABLE * length),
    )
    low = origin + length * np.array(swimming.low)
    high = origin + length * np.array(swimming.high)
    entries = entries_of(objective, lambda one: one.terms[3].wanted)[0]
    movable = (
        _place(place, low, high, [Write(int(entry), axis) for axis, entry in enumerate(entries)]),
        _weight(objective, 0, "effort", 0.1),
        _weight(objective, 1, "smoothness", 0.001),
    )
    period = system.gait.period
    parametrisation = Steered.of(steps, emulator.dt, period, STEERING_KNOTS, system.bounds)
    gait = gait_controls(system, steps, emulator.dt)
    guesses = parametrisation.guess(FIRST_STRENGTH * gait)[None]
    problem = pose_problem(emulator, objective, parametrisation, start)
    about = "Swims to the target, back up."
    return PageDescent("swim to a place", about, problem, guesses, movable)


def judge_swimming(
    system: System, dt: float, values: Values, states: Float[np.ndarray, "T1 S"]
) -> Verdict:
    """Judge a swimmer's motion."""
    length = body_length(system)
    pose = read_pose(system.structure, states)
    gap = float(np.linalg.norm(pose.position[-1] - values["place"]))
    is_upright = ends_upright(system, states, dt)
    roll = math.degrees(float(np.abs(pose.roll).max()))
    words = f"ends {gap:.2f} m ({gap / length:.2f} body lengths) from the target, rolled by {roll:.0f}° at most"
    return Verdict(gap < TARGET_WITHIN * length and is_upright, gap, words)


LANDING_SECONDS = 8.0

LANDING_KNOTS = 20

LANDING_REACH = 4.0
"""[m] How far the pad may be dragged along x and y."""

LANDING_STARTS = 4


def land_on_the_pad(system: System, emulator: Emulator) -> PageDescent:
    """Return the descent of the lander to a pad, softly: as the task does."""
    steps = round(LANDING_SECONDS / emulator.dt)
    start = goal_start(system, "pad")
    over_pad = LANDING_SECONDS - FINAL_DESCENT_SECONDS
    objective = landing_objective(system, over_pad)
    pad = entries_of(objective, lambda one: one.terms[1].goal)
    above = entries_of(objective, lambda one: one.terms[2].wanted)[0]
    # The ground is where it is.
    writes = [Write(int(entries[axis]), axis) for entries in (pad, above) for axis in (0, 1)]
    place = np.array(system.rest[:3], float)
    reach = np.array([LANDING_REACH, LANDING_REACH, 0.0])
    movable = (_place(place, place - reach, place + reach, writes), _weight(objective, 0, "effort", 0.05))  # fmt: skip
    parametrisation = Spline.of(steps, LANDING_KNOTS, system.bounds)
    guesses = _guesses(emulator, parametrisation, LANDING_STARTS)
    problem = pose_problem(emulator, objective, parametrisation, start)
    about = "Lands on the pad, softly and upright."
    return PageDescent("land on the pad", about, problem, guesses, movable)


def judge_landing(
    system: System, dt: float, values: Values, states: Float[np.ndarray, "T1 S"]
) -> Verdict:
    """Judge a lander's motion."""
    moved = np.zeros(states.shape[1])
    moved[:2] = np.array(values["place"][:2]) - system.rest[:2]
    gap = float(np.linalg.norm(states[-1, :2] - values["place"][:2]))
    is_soft = is_soft_landing(system, states - moved)
    how = "softly" if is_soft else "not softly, or not on it"
    words = (
        f"comes down {gap:.2f} m from the middle of the pad (within {PAD_RADIUS:g} m counts), {how}"
    )
    return Verdict(is_soft, gap, words)


PARKING_SECONDS = 12.0

PARKING_KNOTS = 16

PARKING_STARTS = 8

BAY = "bay_2"
"""The bay the truck is shown first."""

LOT = (8.0, 8.0)
"""[m] Half the extent along x and y of where a bay may be dragged."""


def park_in_a_bay(system: System, emulator: Emulator) -> PageDescent:
    """Return the descent of the truck into a bay, touching nothing: as the task does."""
    assert isinstance(system, MujocoSystem)
    steps = round(PARKING_SECONDS / emulator.dt)
    zones = lot_zones(system)
    objective = Objective.of(
        effort(0.02),
        smoothness(0.02),
        goal(system, BAY),
        avoid(system, zones, probes=TRUCK_PROBES, margin=TRUCK_MARGIN, weight=TRUCK_AVOIDANCE),
    )
    at = entries_of(objective, lambda one: one.terms[2].goal)
    bay = read_pose(system.structure, goal_state(system, system.goals[BAY]))
    heading = math.atan2(bay.forward[1], bay.forward[0])
    half = np.array([*LOT, 0.0])
    place = bay.position
    middle = place * (0, 0, 1)
    turned = [Write(int(at[3]), 0), Write(int(at[6]), 1)]
    movable = (
        _place(place, middle - half, middle + half, [Write(int(at[axis]), axis) for axis in (0, 1)]),
        Movable("heading", "heading", "rad", (heading,), (-math.pi,), (math.pi,), tuple(turned)),
        _weight(objective, 0, "effort", 0.02),
        _weight(objective, 1, "smoothness", 0.02),
    )  # fmt: skip
    parametrisation = Spline.of(steps, PARKING_KNOTS, system.bounds)
    guesses = _guesses(emulator, parametrisation, PARKING_STARTS)
    problem = pose_problem(emulator, objective, parametrisation, system.rest)
    about = "Parks at the chosen place, touching nothing."
    return PageDescent("park", about, problem, guesses, movable)


def judge_parking(
    system: System, dt: float, values: Values, states: Float[np.ndarray, "T1 S"]
) -> Verdict:
    """Judge a truck's motion."""
    assert isinstance(system, MujocoSystem)
    wanted = moved_goal(system.goals[BAY], values["place"], values["heading"][0])
    gap = float(np.linalg.norm(states[-1, :2] - values["place"][:2]))
    room = clearance(system, lot_zones(system), states)
    pose = read_pose(system.structure, states[-1])
    turned = math.atan2(pose.forward[1], pose.forward[0]) - values["heading"][0]
    off = abs(math.degrees(math.remainder(turned, 2 * math.pi)))
    touches = "touches nothing" if room > 0 else "touches something"
    words = f"stops {gap:.2f} m and {off:.0f}° off, {touches}"
    return Verdict(is_reached(system, wanted, states[-1]) and room > 0, gap, words)


def moved_goal(wanted: Goal, place: Sequence[float], heading: float) -> Goal:
    """Return the goal of a rigid root, which begins at entry 0, at another place along x and y, and heading [rad]."""
    numbers = dict(wanted.values)
    numbers[0], numbers[1] = float(place[0]), float(place[1])
    numbers |= {3: math.cos(heading / 2), 4: 0.0, 5: 0.0, 6: math.sin(heading / 2)}
    return replace(wanted, values=tuple(numbers.items()))


SWING_SECONDS = 2.0

SWING_STARTS = 16


def swing_up(system: System, emulator: Emulator) -> PageDescent:
    """Return the descent of the pendulum to upright, held for half a second: as the task does."""
    steps = round(SWING_SECONDS / emulator.dt)
    held = round(HOLD_SECONDS / emulator.dt)
    times = tuple(float((steps - i) * emulator.dt) for i in range(held, -1, -HOLD_STRIDE))
    objective = Objective.of(effort(), goal(system, "upright", at=times))
    parametrisation = EachStep.of(steps, system.bounds)
    guesses = _guesses(emulator, parametrisation, SWING_STARTS)
    problem = pose_problem(emulator, objective, parametrisation, system.rest)
    movable = (_weight(objective, 0, "effort", 1.0),)
    about = "Swings all three links up and holds them there."
    return PageDescent("swing up", about, problem, guesses, movable)


def judge_swing(
    system: System, dt: float, values: Values, states: Float[np.ndarray, "T1 S"]
) -> Verdict:
    """Judge a pendulum's motion."""
    held = round(HOLD_SECONDS / dt)
    is_held = all(is_reached(system, "upright", state) for state in states[-held - 1 :])
    links = np.cumsum(states[-1, : len(system.rest) // 2])
    gap = float(np.abs(np.remainder(links, 2 * np.pi) - np.pi).max())
    how = "and is held" if is_held else "but is not held"
    words = f"ends {math.degrees(gap):.0f}° off the vertical at most, {how} for {HOLD_SECONDS:g} s"
    return Verdict(is_held, gap, words)


def _place(
    place: Float[np.ndarray, " 3"],
    low: Float[np.ndarray, " 3"],
    high: Float[np.ndarray, " 3"],
    writes: list[Write],
) -> Movable:
    value, lowest, highest = (tuple(one.tolist()) for one in (place, low, high))
    return Movable("place", "place", "m", value, lowest, highest, tuple(writes))


WEIGHING = 10.0
"""Maximum ratio of a weight to its first value; 0 is allowed too."""


def _weight(objective: Objective, term: int, name: str, value: float) -> Movable:
    entry = entries_of(objective, lambda one: one.terms[term].weight)
    bounds = ((0.0,), (value * WEIGHING,))
    return Movable(name, "number", "", (value,), *bounds, (Write(int(entry), 0),))


def _guesses(
    emulator: Emulator, parametrisation: Parametrisation, count: int
) -> Float[np.ndarray, "K Z"]:
    """Return the middle of the bounds and random controls."""
    return first_guesses(emulator, parametrisation, DescentOptions(starts=count))


class Recipe(NamedTuple):
    """How the descent of a system is made, and how its motions are judged."""

    make: Callable[[System, Emulator], PageDescent]
    judge: Callable[[System, float, Values, Float[np.ndarray, "T1 S"]], Verdict]


DESCENTS = {
    "dolphin": Recipe(swim_to_a_place, judge_swimming),
    "fish": Recipe(swim_to_a_place, judge_swimming),
    "lander": Recipe(land_on_the_pad, judge_landing),
    "pendulum": Recipe(swing_up, judge_swing),
    "truck": Recipe(park_in_a_bay, judge_parking),
}


WITH_DESCENT = tuple(emulator_name(name, SHIPPED_SYSTEMS[name].substeps[0]) for name in DESCENTS)
"""The emulators that ship as bundles with a goal to be reached in the page."""


def descent_of(emulator: Emulator, system: System) -> PageDescent | None:
    """Return what the page can look for with `emulator`; None for systems that are not the package's own."""
    recipe = DESCENTS.get(system.name)
    if recipe is None or emulator.definition:
        return None
    return recipe.make(system, emulator)


def describe_descent(descent: PageDescent, system: System) -> dict[str, Any]:
    """Return what the page reads of a descent."""
    return descent.facts() | {"wasm": DESCENT_FILE, "judged": _judged(descent, system)}


def _judged(descent: PageDescent, system: System) -> dict[str, Any] | None:
    """Return what a page without a server judges a swimmer's motion by; None where only the server can."""
    if DESCENTS[system.name].judge is not judge_swimming:
        return None
    length = body_length(system)
    return {
        "length": length,
        "within": TARGET_WITHIN * length,
        "roll": ROLL_WITHIN,
        "last": steps_of_a_period(system, descent.problem.emulator.dt),
    }


DESCENT_FILE = "descent-1.wasm"
"""The module of a bundle's descent."""


def judge_motion(
    emulator: Emulator,
    system: System,
    values: Values,
    states: Float[np.ndarray, "T1 S"],
) -> Verdict:
    """Return whether `states` of the physics have done what the descent of `system` is for, with these `values`.

    Raises ArgumentError for a motion of another length, and values that are missing or no numbers for it.
    """
    descent = descent_of(emulator, system)
    if descent is None:
        raise ArgumentError(f"descent: there is none for {system.name}.")
    steps = descent.problem.parametrisation.steps
    if len(states) != steps + 1:
        raise ArgumentError(f"states: wanted {steps + 1} rows, got {len(states)}.")
    known = {movable.name: movable.value for movable in descent.movable}
    for name, value in values.items():
        if len(value) != len(known.get(name, ())):
            raise ArgumentError(f"values: wanted {', '.join(known)}, got {name}.")
    recipe = DESCENTS[system.name]
    return recipe.judge(system, emulator.dt, {**known, **values}, states)
