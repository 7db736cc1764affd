"""From an objective to a controller proved on the physics: descend and correct, restart, fine-tune the emulator."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from neuroanimator.control.descent.descend import Descent
from neuroanimator.control.descent.gradient_check import GradientTrust, gradient_trust
from neuroanimator.control.descent.options import check_driven, check_steps
from neuroanimator.control.objective.goals import (
    find_goal,
    goal_objective,
    goal_start,
    is_reached,
    steps_in,
)
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trusted import stay_trusted
from neuroanimator.control.synthesis.attempt import (
    Attempt,
    DivergedAttemptError,
    Search,
    SearchCost,
    SearchOptions,
    make_attempt,
)
from neuroanimator.control.synthesis.replay import Replay
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.slowness import slowness
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System

MAX_SECONDS = 20.0
"""Maximum duration of a motion [s]; longer for a slow system."""

TRUST_DIRECTIONS = 64
"""Number of directions in which the gradient is compared with the physics': a lander's 240 would take far longer."""

RESTARTS = 6
"""Default maximum number of restarts from other guesses while the physics misses the goal."""

SEARCHED = 4096
"""Number of guesses tried by a rollout each before a restart: a second or less."""

SEARCH_STARTS = 16
"""Minimum number of the best guesses to descend from."""


@dataclass(frozen=True)
class Synthesis:
    """A controller and how it was found."""

    emulator: Emulator
    """Emulator that found it, refined if necessary."""
    descent: Descent
    """First descent, before corrections; the cost of all descents is in `spent`."""
    controls: np.ndarray
    """Controls (T, C), proved on the physics, if there is any: see `Replay.is_on_physics`."""
    outcome: Replay
    """These controls on the emulator and on the physics."""
    spent: SearchCost
    """Cost of the whole search."""
    trust: GradientTrust | None = None
    """Trust in the emulator's gradient, if it was measured."""
    is_reached: bool | None = None
    """Whether the physics, or the emulator without physics, ends within the goal's tolerances; None without a goal."""

    def __repr__(self) -> str:
        """Return J on emulator and physics, whether the goal is reached, and whether the emulator is wrong about the motion."""
        outcome = self.outcome
        told = f"{len(self.controls)} super steps, J {outcome.cost_emulator:.3g} on the emulator"
        if outcome.is_on_physics:
            told += f", {outcome.cost_physics:.3g} on the physics"
        if self.is_reached is not None:
            told += f", goal {'reached' if self.is_reached else 'missed'}"
        if outcome.fault:
            told += f". {outcome.fault}"
        return f"Synthesis({told})"


def synthesise(
    emulator: Emulator,
    system: System,
    objective: Objective,
    start: ArrayLike,
    *,
    steps: int | None = None,
    seconds: float | None = None,
    options: SearchOptions = SearchOptions(),
) -> Synthesis:
    """Return the best controller for `steps` super steps, or for `seconds`, from the state `start` (S,), by its J on the physics.

    Replaying a motion on the physics shows the emulator's errors along it. These defects are added to the
    emulator, and the descent goes on from there, up to `corrections` times. If that is not good enough, the search restarts
    from the best of many guesses, alternately around the first one given and random, up to `restarts` times. If the
    gap stays large, a copy of the emulator is trained on the physics around the motion and the search restarts, up to
    `refinements` times, within the minutes of a `Refinement`. `options` says all of this, and may be those of descents alone.

    The search ends as soon as `is_enough` is true of the states (T+1, S) of the physics. If the physics disagrees in the end,
    `measures_trust` measures whether the emulator's gradient can be trusted, at random controls: at its optimum it vanishes.

    Without physics, as for recordings or a missing model, the controller is the best on the emulator,
    which verifies nothing. Nothing is corrected, refined or measured, and `outcome.is_on_physics` is False.

    Raises ArgumentError for an objective that cannot be descended, DivergedError if the physics diverges at the first guess.
    """
    state = emulator.state.check(start, "state")
    if seconds is not None and steps is None:
        steps = steps_in(seconds, emulator.dt, MAX_SECONDS * slowness(emulator.dt))
    elif steps is None or seconds is not None:
        raise ArgumentError("steps and seconds: wanted one of them, the length of the motion.")
    check_steps(steps)
    search = Search(system, objective, state, steps, options)
    attempt = make_attempt(search, emulator, options.descent)
    attempt = restart(search, attempt, options.restarts or 0)
    if options.refine is not None:
        attempt = options.refine(search, attempt)
    trust = None
    if options.measures_trust and attempt.has_large_gap:
        trust = _measure_trust(search, emulator)
    return Synthesis(**vars(attempt), trust=trust)


def restart(search: Search, attempt: Attempt, restarts: int) -> Attempt:
    """Return the best of `attempt` and others from the best of many guesses, with the cost of all of them.

    Guesses alternate between the neighbourhood of the first guess in the options, if there is one, and random controls.
    """
    options = search.options.descent
    around = options.first
    if around is not None and around.ndim == 3:
        around = around[0]
    best = attempt
    spent = attempt.spent
    for number in range(1, restarts + 1):
        if search.options.is_enough(best.outcome.physics_states):
            break
        widely = replace(
            options,
            first=around if number % 2 else None,
            searched=SEARCHED,
            starts=max(options.starts, SEARCH_STARTS),
            seed=options.seed + number,
        )
        try:
            other = make_attempt(search, attempt.emulator, widely)
        except DivergedAttemptError as diverged:
            spent = spent + diverged.spent
            continue
        spent = spent + other.spent
        best = search.better(best, other)
    return replace(best, spent=spent)


def _measure_trust(search: Search, emulator: Emulator) -> GradientTrust:
    """Return the trust in the gradient of the given emulator, at random controls."""
    rng = np.random.default_rng(0)
    controls = sample_control_runs(rng, 1, search.steps, emulator.dt, search.system)[0]
    return gradient_trust(
        emulator,
        search.system,
        search.objective,
        search.options.descent.parametrisation_of(emulator, search.steps),
        search.start,
        controls,
        directions=TRUST_DIRECTIONS,
    )


def check_same_system(emulator: Emulator, system: System) -> None:
    """Refuse a `system` whose states or controls differ from the emulator's by name, and one without controls."""
    check_driven(emulator)
    spec = emulator.spec
    if not system.fits(spec):
        raise ArgumentError(
            f"system: {system.name} has another state or control than the emulator's {spec.system}. "
            "Pass the TOML file it was trained from; goals may be added to it, joints and actuators not."
        )


def synthesise_goal(
    emulator: Emulator,
    system: System,
    name: str,
    seconds: float | None = None,
    *,
    start: ArrayLike | None = None,
    effort_weight: float = 1.0,
    threshold: float | None = None,
    options: SearchOptions = SearchOptions(),
) -> Synthesis:
    """Return the controller that reaches the goal of `system` called `name` from `start` (S,) in `seconds`; see `synthesise`.

    Restarts come last, and only while the goal is missed. `start` and `seconds` default to the goal's own. The goals of
    `system` may be written after training.
    With a `threshold` the motion is kept where the emulator's scores are at most that (`stay_trusted`), which takes
    longer.
    The gradient is not measured if the goal is reached on the physics: it has then proved itself.
    """
    check_same_system(emulator, system)
    # Effort is counted per second, and slow systems take many.
    objective = goal_objective(system, name, effort_weight / slowness(emulator.dt))
    if threshold is not None:
        kept = stay_trusted(emulator, threshold=threshold)
        objective = Objective.of(*objective.terms, *objective.functions, kept)
    goal = find_goal(system, name)
    seconds = goal.seconds if seconds is None else seconds
    steps = steps_in(seconds, emulator.dt, MAX_SECONDS * slowness(emulator.dt))
    begin = emulator.state.check(goal_start(system, name) if start is None else start, "state")
    search = Search(system, objective, begin, steps, options)
    attempt = make_attempt(search, emulator, options.descent)
    if options.refine is not None:
        attempt = options.refine(search, attempt)

    def is_enough(states: np.ndarray) -> bool:
        return is_reached(system, goal, states[-1])

    missed = replace(search, options=replace(options, is_enough=is_enough))
    restarts = RESTARTS if options.restarts is None else options.restarts
    attempt = restart(missed, attempt, restarts)
    reached = is_enough(attempt.outcome.physics_states)
    trust = None
    if options.measures_trust and not reached and system.can_simulate:
        trust = _measure_trust(search, emulator)
    return Synthesis(**vars(attempt), trust=trust, is_reached=reached)
