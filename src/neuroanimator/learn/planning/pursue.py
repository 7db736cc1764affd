"""Pursue a goal in closed loop: plan again at every super step from the actual state of the physics."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.objective.goals import (
    find_goal,
    goal_objective,
    goal_start,
    is_reached,
    steps_in,
)
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.synthesis.attempt import SearchOptions
from neuroanimator.control.synthesis.synthesise import (
    MAX_SECONDS,
    RESTARTS,
    SEARCH_STARTS,
    SEARCHED,
    synthesise,
)
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.planning.planner import Planner
from neuroanimator.learn.planning.plants import (
    ControlledMotion,
    Replanning,
    control_plant,
    drive,
)
from neuroanimator.learn.planning.regulator import Regulator, regulator_of
from neuroanimator.state.slowness import slowness
from neuroanimator.systems.plants import EmulatorPlant, PhysicsPlant
from neuroanimator.systems.system import System
from neuroanimator.terminal import Rows, phase

HORIZON_STEPS = 20
"""Default horizon of a plan [super steps]: super steps are chosen to suit a system, so this fits slow and quick ones."""

MAX_HORIZON_STEPS = 400
"""Maximum horizon of a plan [super steps]: Gauss-Newton's model grows with the square of its numbers."""

GUESSES = 32
"""Number of random controls tried at every plan. Without any the lander does not find its pad from 6 m up."""

MAX_PURSUIT_SECONDS = 600.0
"""Maximum duration of a motion in closed loop [s]; longer for a slow system."""


@dataclass(frozen=True)
class Pursuit:
    """A motion in closed loop, and when it was at its goal."""

    motion: ControlledMotion
    is_at_goal: Bool[np.ndarray, " N"]
    """Whether each state is at the goal."""
    dt: float
    """Super step [s]."""
    is_on_physics: bool
    """Whether the physics moved; without one, as for recordings, the emulator did, which proves nothing."""
    way_steps: int = 0
    """Number of super steps of a motion to the goal that was found by a search and played; 0 if plans alone reached it."""
    search_seconds: float = 0.0
    """Time of this search [s]."""

    @property
    def is_reached(self) -> bool:
        """Whether the motion ends at its goal."""
        return bool(self.is_at_goal[-1])

    @property
    def seconds_to_goal(self) -> float:
        """Time from which it stays at the goal [s]; meaningless unless `is_reached`."""
        away = np.flatnonzero(~self.is_at_goal)
        return self.dt * (int(away[-1]) + 1 if len(away) else 0)


def pursue_goal(
    emulator: Emulator,
    system: System,
    name: str,
    seconds: float | None = None,
    *,
    start: ArrayLike | None = None,
    horizon: float | None = None,
    effort_weight: float = 1.0,
    guesses: int = GUESSES,
    on_step: Callable[[int], None] = lambda step: None,
) -> Pursuit:
    """Return the motion of `system` towards its goal called `name`, for `seconds`, planned `horizon` [s] ahead.

    A plan aims to be at the goal throughout the second half of its horizon. If such plans do not reach it, as with bodies that
    have to pump, a motion to it is searched for as in `synthesise_goal` and played first. `start` (S,) and `seconds` default
    to the goal's own. `on_step` is called after each super step.

    Raises ArgumentError for times and weights out of range.
    """
    wanted = find_goal(system, name)
    dt = emulator.dt
    steps = pursuit_steps(emulator, system, name, seconds)
    horizon = HORIZON_STEPS * dt if horizon is None else horizon
    if not 2 * dt <= horizon <= MAX_HORIZON_STEPS * dt:
        raise ArgumentError(
            f"horizon: wanted between {2 * dt:g} and {MAX_HORIZON_STEPS * dt:g} s, got {horizon:g}."
        )
    begin = np.asarray(goal_start(system, name) if start is None else start, float)
    # Effort is counted per second, and slow systems take many.
    weight = effort_weight / slowness(dt)
    objective = goal_objective(system, name, weight, since=horizon / 2)
    with phase("compiling"):
        planner = Planner.of(emulator, objective, round(horizon / dt), guesses=guesses)
    is_on_physics = system.can_simulate
    plant = PhysicsPlant(system, dt) if is_on_physics else EmulatorPlant(emulator)

    def pursuit_of(motion: ControlledMotion, way_steps: int = 0, seconds: float = 0.0) -> Pursuit:
        at_goal = np.array([is_reached(system, wanted, state) for state in motion.states])
        return Pursuit(motion, at_goal, dt, is_on_physics, way_steps, seconds)

    planned = pursuit_of(control_plant(planner, plant, begin, steps, on_step=on_step))
    if planned.is_reached or not is_on_physics:
        return planned
    regulator = regulator_of(plant, system, wanted, emulator.bounds, dt, weight)
    way_steps = min(steps, steps_in(wanted.seconds, dt, MAX_SECONDS * slowness(dt)))
    began = time.perf_counter()
    with phase("searching for a motion to the goal"):
        way = _way(emulator, system, name, weight, begin, way_steps, regulator)
    search_seconds = time.perf_counter() - began
    kept_by = Replanning(planner) if regulator is None else regulator

    def control_of(step: int, state: np.ndarray) -> np.ndarray:
        return way[step] if step < way_steps else kept_by(state)

    motion = drive(plant, begin, control_of, steps, on_step=on_step)
    if isinstance(kept_by, Replanning):
        motion = kept_by.timed(motion)
    return pursuit_of(motion, way_steps, search_seconds)


def _way(
    emulator: Emulator,
    system: System,
    name: str,
    effort_weight: float,
    start: Float[np.ndarray, " S"],
    steps: int,
    regulator: Regulator | None,
) -> Float[np.ndarray, "T C"]:
    """Return the best controls, from several wide searches, to the goal, or to where `regulator` takes over."""
    wanted = find_goal(system, name)
    objective = goal_objective(system, name, effort_weight)
    if regulator is not None:
        objective = Objective.of(*objective.terms, regulator.cost_to_go())

    def is_enough(states: np.ndarray) -> bool:
        if regulator is not None:
            return regulator.holds(states[-1])
        return is_reached(system, wanted, states[-1])

    widely = DescentOptions(searched=SEARCHED, starts=SEARCH_STARTS)
    options = SearchOptions(widely, restarts=RESTARTS, is_enough=is_enough)
    return synthesise(emulator, system, objective, start, steps=steps, options=options).controls


def pursuit_steps(emulator: Emulator, system: System, name: str, seconds: float | None) -> int:
    """Return the number of super steps of a pursuit, from `seconds` or by default the goal's."""
    if seconds is None:
        seconds = find_goal(system, name).seconds
    return steps_in(seconds, emulator.dt, MAX_PURSUIT_SECONDS * slowness(emulator.dt))


def pursuit_rows(pursuit: Pursuit) -> Rows:
    """Return names and values of the results, the verdict last."""
    motion = pursuit.motion
    rows: Rows = [("super steps", f"{len(motion.controls)}, {pursuit.dt:g} s each")]
    if len(motion.plan_seconds):
        plan_ms = np.median(motion.plan_seconds) * 1e3
        took = f"{plan_ms:.1f} ms; 99 of 100 at most {motion.p99_ms:.1f} ms"
        if plan_ms > pursuit.dt * 1e3:
            took += f"; slower than real time, as a super step lasts {pursuit.dt * 1e3:.3g} ms"
        rows.append(("a plan takes", took))
    if pursuit.way_steps:
        played = pursuit.way_steps * pursuit.dt
        way = f"searched for in {pursuit.search_seconds:.1f} s and played for {played:.4g} s"
        rows.append(("motion to the goal", way))
    where = (
        "on the true physics"
        if pursuit.is_on_physics
        else "on the emulator, which verifies nothing"
    )
    answer = "no"
    if pursuit.is_reached:
        answer = f"yes, from {pursuit.seconds_to_goal:.4g} s on"
    elif pursuit.is_at_goal.any():
        answer = "no: reached, then left again"
    return [*rows, (f"goal reached {where}", answer)]
