"""From an objective to a controller proved on the physics: descend, replay, correct, refine, again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from neuroanimator.control.descent.defects import defects_of
from neuroanimator.control.descent.descend import Descent, controls_of, descend
from neuroanimator.control.descent.gradient_check import GradientTrust, gradient_trust
from neuroanimator.control.descent.parametrisation import EachStep, Parametrisation
from neuroanimator.control.objective.goals import find_goal, goal_start
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.synthesis.replay import Replay, beside_emulated, ranked_on_physics
from neuroanimator.data.sampling import sample_control_runs
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.evaluation.held_out import system_of
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase

LARGE_GAP, LARGE_SHARE = 0.5, 0.25
"""A gap of J above both this and this share of J is worth refining: half of what one end-state number off by its
scale costs."""
SMALL_GAIN = 0.05
"""Share of J on the physics that a correction must promise to win, to be worth a replay."""
CORRECTING_ITERATIONS = 2
"""A corrected emulator is exact along one motion: few steps away from it, then the next replay."""
LONGEST = 20.0
"""[s] Longest motion searched for."""
REPLAYED = 4
"""Descents from different first guesses that are replayed: the emulator's best need not be the physics' best."""
TRUST_DIRECTIONS = 64
"""In which the gradient is compared with the physics': a lander's 240 would take longer than all else together."""
SHARES = (1.0, 0.5, 0.2, 0.05)
"""Of the way to corrected controls, all tried on the physics: where it bends away, a shorter way is better."""


@dataclass(frozen=True)
class Synthesis:
    """A controller and how it came about."""

    emulator: Emulator
    """The one that found it: refined if refining was needed."""
    descent: Descent
    """The last one, its `controls` those proved on the physics; iterations and seconds are of all descents."""
    outcome: Replay
    corrections: int
    """Replays whose defects were added to the emulator."""
    refinements: int
    """Trainings on the physics around the motion."""
    physics_steps: int
    """Physics steps taken on the way, the data of refinements included."""
    trust: GradientTrust | None = None
    """In the emulator's gradient, if it was measured."""
    is_reached: bool | None = None
    """Whether the physics ends within the goal's tolerances; None where no named goal was asked for."""


def synthesise(
    emulator: Emulator,
    system: System,
    objective: Objective,
    start: np.ndarray,
    *,
    steps: int,
    corrections: int = 5,
    restarts: int = 0,
    refinements: int = 2,
    data: Transitions | None = None,
    on_refine: Callable[[float], None] = lambda gap: None,
    is_enough: Callable[[np.ndarray], bool] = lambda states: False,
    measures_trust: bool = False,
    **options: Any,
) -> Synthesis:
    """Return the best controller by its J on the physics; `options` are those of `descend`.

    All ends as soon as the states (T+1, S) of the physics are good enough. Whether the emulator's gradient can be
    trusted is measured at random controls, if asked for: at its optimum it vanishes.

    A motion replayed on the physics shows what the emulator gets wrong along it. These defects are added to the
    emulator, and the descent goes on from there, up to `corrections` times. Where that is not good enough, all begins
    again from random controls, up to `restarts` times. Where the gap stays large,
    transitions around the motion are added to `data` (what the emulator was trained on; simulated anew
    if not given), a copy of the emulator trains on, and all begins again, up to `refinements` times.
    """
    problem = system, objective, start, steps, corrections, is_enough
    found = best = _descend_and_correct(emulator, *problem, options)
    for guesses in _random_guesses(emulator, steps, restarts, options):
        if is_enough(best.outcome.physics_states):
            break
        found = _after(
            found, _descend_and_correct(emulator, *problem, {**options, "first": guesses})
        )
        best = _better(best, found, is_enough)
    found = best = _charged(best, found)
    made = round_ = 0
    while (
        round_ < refinements
        and is_gap_large(found.outcome.cost_emulator, found.outcome.cost_physics)
        and not is_enough(best.outcome.physics_states)
    ):
        on_refine(found.outcome.gap)
        round_ += 1
        motion = found.outcome.physics_states, found.descent.controls
        with phase("learning the physics around the motion"):
            from neuroanimator.control.synthesis.finetune import (
                refined,  # training's modules, which most motions do without
            )

            better, data, taken = refined(found.emulator, system, data, *motion, round_)
        made += taken
        again = {**options, "first": found.descent.controls}
        more = _descend_and_correct(better, *problem, again)
        found = _after(found, replace(more, refinements=round_))
        best = _better(best, found, is_enough)
    best = _charged(best, replace(found, physics_steps=found.physics_steps + made))
    if not measures_trust:
        return best
    parametrisation = _parameters(emulator, steps, options)
    controls = sample_control_runs(np.random.default_rng(0), 1, steps, emulator.dt, system)[0]
    trust = gradient_trust(
        emulator, system, objective, parametrisation, start, controls, directions=TRUST_DIRECTIONS
    )
    return replace(best, trust=trust)


def _parameters(emulator: Emulator, steps: int, options: dict[str, Any]) -> Parametrisation:
    return options.get("parametrisation") or EachStep.of(
        steps, options.get("bounds") or emulator.bounds
    )


def is_gap_large(cost_emulator: float, cost_physics: float) -> bool:
    """Return whether the physics disagrees with the emulator so much that more effort is worth its time."""
    return cost_physics - cost_emulator > max(LARGE_GAP, LARGE_SHARE * cost_physics)


def _after(earlier: Synthesis, later: Synthesis) -> Synthesis:
    """Return `later` with what `earlier` cost counted in."""
    descent = replace(
        later.descent,
        iterations=earlier.descent.iterations + later.descent.iterations,
        seconds=earlier.descent.seconds + later.descent.seconds,
    )
    return replace(
        later,
        descent=descent,
        corrections=earlier.corrections + later.corrections,
        physics_steps=earlier.physics_steps + later.physics_steps,
    )


def _charged(best: Synthesis, last: Synthesis) -> Synthesis:
    """Return `best` with all that was spent until `last`."""
    descent = replace(
        best.descent, iterations=last.descent.iterations, seconds=last.descent.seconds
    )
    spent = {name: getattr(last, name) for name in ("corrections", "refinements", "physics_steps")}
    return replace(best, descent=descent, **spent)


def _better(one: Synthesis, other: Synthesis, is_enough: Callable[[np.ndarray], bool]) -> Synthesis:
    """Return the one that is good enough, or else the cheaper one on the physics."""
    return min(
        one,
        other,
        key=lambda found: (not is_enough(found.outcome.physics_states), found.outcome.cost_physics),
    )


def _random_guesses(
    emulator: Emulator, steps: int, restarts: int, options: dict[str, Any]
) -> Iterator[np.ndarray]:
    """Yield controls (starts, T, C) to begin again from, as training saw them."""
    rng, starts = np.random.default_rng([options.get("seed", 0), 12]), options.get("starts", 1)
    for _ in range(restarts):
        yield sample_control_runs(rng, starts, steps, emulator.dt, emulator.spec)


def _descend_and_correct(
    emulator: Emulator,
    system: System,
    objective: Objective,
    start: np.ndarray,
    steps: int,
    corrections: int,
    is_enough: Callable[[np.ndarray], bool],
    options: dict[str, Any],
) -> Synthesis:
    """Return the best of the descents once corrected: of the physics' best, and where that fails of the next ones."""
    descent = descend(emulator, objective, start, steps=steps, **options)
    motions = ranked_on_physics(emulator, system, objective, start, descent.candidates[:REPLAYED])
    parametrisation, starts = _parameters(emulator, steps, options), options.get("starts", 1)
    again = {**options, "parametrisation": parametrisation, "iterations": CORRECTING_ITERATIONS}
    best, iterations, seconds, done, played = (
        motions[0],
        descent.iterations,
        descent.seconds,
        0,
        len(motions),
    )
    for motion in motions:
        for _ in range(corrections):
            if is_enough(motion.states):
                break
            with phase("correcting"):
                defects = defects_of(emulator, motion.states, motion.controls)
            # As many starts as in the first descent, all the same: nothing needs to be compiled anew.
            corrected = {**again, "first": np.stack([motion.controls] * starts), "defects": defects}
            more = descend(emulator, objective, start, steps=steps, **corrected)
            iterations, seconds, done = (
                iterations + more.iterations,
                seconds + more.seconds,
                done + 1,
            )
            if motion.cost - more.cost < SMALL_GAIN * abs(motion.cost):
                break
            ways = between(parametrisation, motion.controls, more.controls)
            following, played = (
                ranked_on_physics(emulator, system, objective, start, ways)[0],
                played + len(ways),
            )
            if following.cost >= motion.cost:
                break
            motion = following
        best = motion if motion.cost < best.cost or is_enough(motion.states) else best
        if is_enough(best.states) or not is_gap_large(descent.cost, best.cost):
            break
    descent = replace(descent, controls=best.controls, iterations=iterations, seconds=seconds)
    physics_steps = played * steps * system.truth.steps(emulator.dt)
    return Synthesis(
        emulator, descent, beside_emulated(emulator, objective, best), done, 0, physics_steps
    )


def between(parametrisation: Parametrisation, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return controls (K, T, C) on the way from `old` to `new`."""
    first = parametrisation.guess(old)
    way = parametrisation.guess(new) - first
    z = first + np.array(SHARES)[:, None] * way
    return np.asarray(controls_of(parametrisation, z.astype(np.float32)), float)


def check_same_system(emulator: Emulator, system: System) -> None:
    """Refuse a `system` whose states or controls are not the emulator's, by name."""
    spec = emulator.spec
    if (system.state, system.control) != (spec.state, spec.control):
        raise ArgumentError(
            f"system: {system.name} has another state or control than the emulator's {spec.system}. "
            "Pass the TOML file it was trained from; goals may be added to it, joints and actuators not."
        )


def synthesise_goal(
    emulator: Emulator,
    goal: str,
    seconds: float | None = None,
    *,
    start: np.ndarray | None = None,
    effort_weight: float = 1.0,
    goals_from: System | None = None,
    **options: Any,
) -> Synthesis:
    """Return the controller that reaches the named `goal` from `start` (S,) in `seconds`; options as `synthesise`.

    `start` and `seconds` default to what the goal itself says is sensible; a start that is there already can be told
    by `find_goal`'s verdict. `goals_from` is the emulator's system with other goals: they may be written after
    training.
    """
    system = system_of(emulator)
    named = system if goals_from is None else goals_from
    check_same_system(emulator, named)
    if not 0 <= effort_weight < float("inf"):
        raise ArgumentError(
            f"effort_weight: wanted a finite number of at least 0, came {effort_weight:g}."
        )
    objective, verdict, usual = find_goal(named, goal, effort_weight)
    seconds = usual if seconds is None else seconds
    if not emulator.dt <= seconds <= LONGEST:
        raise ArgumentError(
            f"seconds: wanted between {emulator.dt:g} and {LONGEST:g}, came {seconds:g}."
        )
    begin = goal_start(system, goal) if start is None else start
    found = synthesise(
        emulator, system, objective, begin, steps=round(seconds / emulator.dt), **options
    )
    return replace(found, is_reached=verdict(found.outcome.physics_states[-1]))
