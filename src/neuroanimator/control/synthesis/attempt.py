"""One attempt at a controller: descend through the emulator, replay on the physics, correct by the replay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from neuroanimator.control.descent.defects import find_defects
from neuroanimator.control.descent.descend import Descent, controls_of, descend
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.synthesis.replay import (
    Replay,
    ReplayedMotion,
    beside_emulated,
    is_gap_large,
    ranked_motions,
)
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import DivergedError
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase

SMALL_GAIN = 0.05
"""Minimum gain predicted for a correction to be worth a replay, as a share of J on the physics."""

CORRECTING_ITERATIONS = 2
"""Number of backward sweeps after a correction: the emulator is then exact along one motion, so few steps, then a replay."""

MAX_REPLAYED = 4
"""Maximum number of replayed descents from different first guesses: the emulator's best need not be the physics' best."""

LINE_SHARES = (1.0, 0.5, 0.2, 0.05)
"""Step lengths toward corrected controls, all tried on the physics: where it departs, a shorter step is better."""


@dataclass(frozen=True)
class SearchCost:
    """Cost of a search; the costs of its parts add up."""

    iterations: int = 0
    """Number of backward sweeps of all descents."""
    seconds: float = 0.0
    """Time of all descents [s], compilation and replays excluded."""
    corrections: int = 0
    """Number of replays whose defects were added to the emulator."""
    refinements: int = 0
    """Number of trainings on the physics around a motion."""
    minutes_wanted: float = 0.0
    """Approximate time needed for another training [min]; 0 if none was given up."""
    physics_steps: int = 0
    """Number of physics steps of replays, and of the data of refinements."""
    courses: tuple[tuple[float, ...], ...] = ()
    """J on the emulator initially and after each sweep, for each descent in order."""

    def __add__(self, other: SearchCost) -> SearchCost:
        parts = zip(vars(self).values(), vars(other).values(), strict=True)
        return SearchCost(*(one + more for one, more in parts))

    @classmethod
    def of_descent(cls, descent: Descent) -> SearchCost:
        """Return the cost of a descent."""
        return cls(iterations=descent.iterations, seconds=descent.seconds, courses=(descent.costs,))


class DivergedAttemptError(DivergedError):
    """The physics diverged under all controls that a descent found."""

    def __init__(self, message: str, spent: SearchCost):
        super().__init__(message)
        self.spent = spent
        """Cost of the attempt."""


@runtime_checkable
class Refiner(Protocol):
    """Trains emulators on the physics around motions, in the course of a search."""

    def __call__(self, search: Search, attempt: Attempt) -> Attempt:
        """Return the best of `attempt` and others with emulators trained on the physics around it, with the cost of all."""
        ...


@dataclass(frozen=True)
class SearchOptions:
    """Options of a search for a controller: of its descents, and of what follows their replays on the physics."""

    descent: DescentOptions = DescentOptions()
    """Options of its descents."""
    corrections: int = 5
    """Maximum number of replays whose defects are added to the emulator, for each motion that is corrected."""
    restarts: int | None = None
    """Maximum number of restarts from the best of many guesses; by default 6 for a goal, otherwise none."""
    refinements: int = 2
    """Maximum number of times that the emulator is trained on the physics around a motion, while the gap stays large."""
    refine: Refiner | None = None
    """What trains the emulator; the package's functions hand in `Refinement()` if it is None."""
    is_enough: Callable[[np.ndarray], bool] = lambda states: False
    """Whether states (T+1, S) of the physics are good enough to end the search; restarts for a goal also end at the goal."""
    measures_trust: bool = False
    """Whether to measure, if the physics disagrees in the end, how far the emulator's gradient can be trusted."""


@dataclass(frozen=True)
class Search:
    """Problem and options of a search; the emulator is separate, as it may be refined on the way."""

    system: System
    objective: Objective
    start: np.ndarray
    """Initial state (S,)."""
    steps: int
    """Number of super steps of the motion."""
    options: SearchOptions

    def is_better(self, new: ReplayedMotion, old: ReplayedMotion) -> bool:
        """Return whether `new` is preferable to `old`: good enough, or cheaper."""
        return new.cost < old.cost or self.options.is_enough(new.states)

    def replay(
        self, emulator: Emulator, candidates: Float[np.ndarray, "K T C"]
    ) -> list[ReplayedMotion]:
        """Return the motions of candidates on the physics, if there is any, the least J first."""
        return ranked_motions(emulator, self.system, self.objective, self.start, candidates)

    def better(self, old: Attempt, new: Attempt) -> Attempt:
        """Return the one that is good enough, otherwise the cheaper one on the physics; `old` if they are equal."""

        def rank(attempt: Attempt) -> tuple[bool, float]:
            outcome = attempt.outcome
            return not self.options.is_enough(outcome.physics_states), outcome.cost_physics

        return min(old, new, key=rank)

    def cost_of_replays(self, emulator: Emulator, count: int) -> SearchCost:
        """Return the cost of `count` replays: none without physics."""
        if not self.system.can_simulate:
            return SearchCost()
        steps = count * self.steps * self.system.truth.steps(emulator.dt)
        return SearchCost(physics_steps=steps)


@dataclass(frozen=True)
class Attempt:
    """A controller, proved on the physics, and its cost."""

    emulator: Emulator
    """Emulator it was found with."""
    descent: Descent
    """The first descent, before corrections."""
    controls: np.ndarray
    """Controls (T, C), the best on the physics."""
    outcome: Replay
    spent: SearchCost

    @property
    def has_large_gap(self) -> bool:
        """Whether the physics, if there is any, disagrees so much that training the emulator on it is worth the time."""
        outcome = self.outcome
        return outcome.is_on_physics and is_gap_large(outcome.cost_emulator, outcome.cost_physics)


def make_attempt(search: Search, emulator: Emulator, options: DescentOptions) -> Attempt:
    """Return the best of the corrected descents: the physics' best is corrected, and if that fails the next ones.

    Raises DivergedAttemptError if the physics diverges under all replayed controls.
    """
    # One for all descents, so that nothing is recompiled.
    parametrisation = options.parametrisation_of(emulator, search.steps)
    options = replace(options, parametrisation=parametrisation)
    descent = descend(emulator, search.objective, search.start, steps=search.steps, options=options)
    candidates = descent.candidates[:MAX_REPLAYED]
    spent = SearchCost.of_descent(descent) + search.cost_of_replays(emulator, len(candidates))
    try:
        motions = search.replay(emulator, candidates)
    except DivergedError as error:
        raise DivergedAttemptError(str(error), spent) from error
    best = motions[0]
    for motion in motions:
        corrected, cost = correct(search, emulator, options, motion)
        spent = spent + cost
        if search.is_better(corrected, best):
            best = corrected
        if search.options.is_enough(best.states) or not is_gap_large(descent.cost, best.cost):
            break
    outcome = beside_emulated(emulator, search.system, search.objective, best)
    return Attempt(emulator, descent, best.controls, outcome, spent)


def correct(
    search: Search, emulator: Emulator, options: DescentOptions, motion: ReplayedMotion
) -> tuple[ReplayedMotion, SearchCost]:
    """Return (the best motion that corrections of `motion` lead to, their cost).

    The emulator's defects along the motion are added to it, a short descent follows, and its controls, as well as
    some on the way to them, are replayed; this is repeated as long as the physics' J decreases.
    """
    parametrisation = options.parametrisation_of(emulator, search.steps)
    options = replace(
        options, parametrisation=parametrisation, iterations=CORRECTING_ITERATIONS, searched=0
    )
    spent = SearchCost()
    corrections = search.options.corrections if search.system.can_simulate else 0
    for _ in range(corrections):
        if search.options.is_enough(motion.states):
            break
        with phase("correcting"):
            defects = find_defects(emulator, motion.states, motion.controls)
        # As many starts as in the first descent, all equal, so that nothing is recompiled.
        same_starts = np.stack([motion.controls] * options.starts)
        descent = descend(
            emulator,
            search.objective,
            search.start,
            steps=search.steps,
            options=replace(options, first=same_starts, defects=defects),
        )
        spent = spent + SearchCost.of_descent(descent) + SearchCost(corrections=1)
        promised_gain = motion.cost - descent.cost
        if promised_gain < SMALL_GAIN * abs(motion.cost):
            break
        candidates = between(parametrisation, motion.controls, descent.controls)
        spent = spent + search.cost_of_replays(emulator, len(candidates))
        try:
            following = search.replay(emulator, candidates)[0]
        except DivergedError:
            break
        if following.cost >= motion.cost:
            break
        motion = following
    return motion, spent


def between(
    parametrisation: Parametrisation,
    old: Float[np.ndarray, "T C"],
    new: Float[np.ndarray, "T C"],
) -> Float[np.ndarray, "K T C"]:
    """Return controls between `old` and `new`, at `LINE_SHARES` of the step."""
    first = parametrisation.guess(old)
    difference = parametrisation.guess(new) - first
    z = first + np.array(LINE_SHARES)[:, None] * difference
    return controls_of(parametrisation, z)
