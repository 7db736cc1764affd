"""One attempt at a controller: descend through the emulator, replay on the physics, correct by what the replay shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

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
    ranked_motions,
)
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import DivergedError
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase

LARGE_GAP = 0.5
"""A gap of J up to this is small: half of what one end-state number off by its scale costs."""

LARGE_GAP_SHARE = 0.25
"""A gap of J up to this share of J on the physics is small too."""

SMALL_GAIN = 0.05
"""A correction must promise to win this share of J on the physics, to be worth a replay."""

CORRECTING_ITERATIONS = 2
"""Backward sweeps after a correction: the emulator is then exact along one motion, so few steps away, and replay again."""

MAX_REPLAYED = 4
"""Maximum number of replays of descents from different first guesses: the emulator's best need not be the physics' best."""

LINE_SHARES = (1.0, 0.5, 0.2, 0.05)
"""Shares of the way to corrected controls, all tried on the physics: where it bends away, a shorter way is better."""


@dataclass(frozen=True)
class SearchCost:
    """What a search has taken; costs of its parts add up."""

    iterations: int = 0
    """Backward sweeps of all descents."""
    seconds: float = 0.0
    """Time of all descents [s], compilation and replays excluded."""
    corrections: int = 0
    """Replays whose defects were added to the emulator."""
    refinements: int = 0
    """Trainings on the physics around a motion."""
    minutes_wanted: float = 0.0
    """Time that one more training would have needed, about [min]; 0 where none was given up."""
    physics_steps: int = 0
    """Physics steps of replays, and of the data of refinements."""
    courses: tuple[tuple[float, ...], ...] = ()
    """J on the emulator at first and after each sweep, descent by descent, in the order they were made in."""

    def __add__(self, other: SearchCost) -> SearchCost:
        return SearchCost(
            self.iterations + other.iterations,
            self.seconds + other.seconds,
            self.corrections + other.corrections,
            self.refinements + other.refinements,
            self.minutes_wanted + other.minutes_wanted,
            self.physics_steps + other.physics_steps,
            self.courses + other.courses,
        )

    @classmethod
    def of_descent(cls, descent: Descent) -> SearchCost:
        """Return what a descent took."""
        return cls(iterations=descent.iterations, seconds=descent.seconds, courses=(descent.costs,))


class DivergedAttemptError(DivergedError):
    """The physics diverged under all that a descent found."""

    def __init__(self, message: str, spent: SearchCost):
        super().__init__(message)
        self.spent = spent
        """What it took."""


@dataclass(frozen=True)
class Search:
    """What is searched for, and how; the emulator is given apart, for it may learn on the way."""

    system: System
    objective: Objective
    start: np.ndarray
    """(S,)"""
    steps: int
    """Super steps of the motion."""
    options: DescentOptions
    corrections: int
    """Replays, at most, whose defects are added to the emulator."""
    is_enough: Callable[[np.ndarray], bool]
    """Whether states (T+1, S) of the physics are good enough to end the search."""

    def is_better(self, new: ReplayedMotion, old: ReplayedMotion) -> bool:
        """Return whether `new` is to be preferred to `old`: it is good enough, or cheaper."""
        return new.cost < old.cost or self.is_enough(new.states)

    def replay(
        self, emulator: Emulator, candidates: Float[np.ndarray, "K T C"]
    ) -> list[ReplayedMotion]:
        """Return what candidates do on the physics, if there is any, the least J first."""
        return ranked_motions(emulator, self.system, self.objective, self.start, candidates)

    def cost_of_replays(self, emulator: Emulator, count: int) -> SearchCost:
        """Return what so many replays take: nothing where there is no physics."""
        if not self.system.can_simulate:
            return SearchCost()
        steps = count * self.steps * self.system.truth.steps(emulator.dt)
        return SearchCost(physics_steps=steps)


@dataclass(frozen=True)
class Attempt:
    """A controller, proved on the physics, and what it took."""

    emulator: Emulator
    """The one it was found with."""
    descent: Descent
    """The first descent, before corrections."""
    controls: np.ndarray
    """(T, C) the best on the physics."""
    outcome: Replay
    spent: SearchCost

    @property
    def has_large_gap(self) -> bool:
        """Whether the physics disagrees so much that teaching it to the emulator is worth the time."""
        return is_gap_large(self.outcome.cost_emulator, self.outcome.cost_physics)


def is_gap_large(cost_emulator: float, cost_physics: float) -> bool:
    """Return whether the physics disagrees with the emulator so much that more effort is worth its time."""
    return cost_physics - cost_emulator > max(LARGE_GAP, LARGE_GAP_SHARE * cost_physics)


def make_attempt(search: Search, emulator: Emulator, options: DescentOptions) -> Attempt:
    """Return the best of the descents once corrected: of the physics' best, and where that fails of the next ones.

    Raises DivergedAttemptError where the physics diverges under all that are replayed.
    """
    # One for all descents: what was compiled for it is found again.
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
        if search.is_enough(best.states) or not is_gap_large(descent.cost, best.cost):
            break
    outcome = beside_emulated(emulator, search.system, search.objective, best)
    return Attempt(emulator, descent, best.controls, outcome, spent)


def correct(
    search: Search, emulator: Emulator, options: DescentOptions, motion: ReplayedMotion
) -> tuple[ReplayedMotion, SearchCost]:
    """Return (the best motion that corrections lead to from `motion`, what they took).

    What the emulator gets wrong along the motion is added to it, a short descent follows, and its controls, as well as
    some on the way to them, are replayed; as long as that makes the physics' J smaller.
    """
    parametrisation = options.parametrisation_of(emulator, search.steps)
    options = replace(
        options, parametrisation=parametrisation, iterations=CORRECTING_ITERATIONS, searched=0
    )
    spent = SearchCost()
    corrections = search.corrections if search.system.can_simulate else 0
    for _ in range(corrections):
        if search.is_enough(motion.states):
            break
        with phase("correcting"):
            defects = find_defects(emulator, motion.states, motion.controls)
        # As many starts as in the first descent, all the same: nothing needs to be compiled anew.
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
    """Return controls on the way from `old` to `new`, at `LINE_SHARES` of it."""
    first = parametrisation.guess(old)
    difference = parametrisation.guess(new) - first
    z = first + np.array(LINE_SHARES)[:, None] * difference
    return controls_of(parametrisation, z)
