"""Find controls from any state in milliseconds, without compilation."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from neuroanimator.control.descent.descend import (
    advance,
    evaluator_of,
    pose_problem,
    random_guesses,
)
from neuroanimator.control.descent.evaluator import Evaluator
from neuroanimator.control.descent.methods import METHODS, best_first
from neuroanimator.control.descent.options import DEFAULT_METHOD, check_method
from neuroanimator.control.descent.parametrisation import EachStep, Parametrisation
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.objective_cost import check_objective
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Bounds

ITERATIONS = 2
"""Default number of backward sweeps per plan: the shifted last plan is nearly optimal. They swing the pendulum up and hold it."""

WAVES = 13
"""Number joined to the seed of waves, so that they differ from other random numbers of that seed."""

MAX_WAVE_FREQUENCY = 1.5
"""Maximum frequency of waves [Hz], which is also at most a quarter of a period per super step."""

MIN_WAVE_SHARE = 0.1
"""Minimum frequency of waves, as a share of the maximum."""

MIN_WAVE_HEIGHT = 0.4
"""Minimum amplitude of waves, as a share of the controls' range to either side."""

MAX_BEND = 0.5
"""Maximum offset of half of the waves, which makes bodies turn, as a share of the range to one side."""

MAX_GUESSES = 4096
"""Maximum number of guesses tried at every plan: J of each takes as long as a rollout."""


@dataclass(frozen=True)
class Plan:
    """The best controls found from one state."""

    controls: np.ndarray
    """Controls (T, C) within the bounds."""
    states: np.ndarray
    """Emulated motion (T+1, S) under them."""
    cost: float
    """J on the emulator."""
    seconds: float
    """Time from the measured state to the controls [s]."""


@dataclass(frozen=True)
class Planner:
    """Finds controls from any state, without compilation; made by `Planner.of`."""

    emulator: Emulator
    objective: Objective
    parametrisation: Parametrisation
    method: str
    iterations: int
    """Maximum number of backward sweeps per plan."""
    starts: int
    """Number of guesses to descend from, beside the last plan."""
    guesses: Float[np.ndarray, "K Z"] = field(repr=False)
    """Controls tried at every plan, as numbers of the parametrisation."""
    _evaluator: Evaluator = field(repr=False)
    """Evaluator of motions from the emulator's rest."""

    @classmethod
    def of(
        cls,
        emulator: Emulator,
        objective: Objective,
        steps: int,
        *,
        iterations: int = ITERATIONS,
        method: str = DEFAULT_METHOD,
        bounds: Bounds | None = None,
        parametrisation: Parametrisation | None = None,
        guesses: int = 0,
        starts: int = 1,
        seed: int = 0,
    ) -> Planner:
        """Return a planner that looks `steps` super steps ahead, compiled, which takes some seconds.

        Times in `objective` count from the planned state, so a goal `since` 0 s is one to stay at. `bounds`
        may be tighter than the emulator's own; a `parametrisation` has its own.
        Of `guesses` guesses, random ones and waves, the same at every plan, the best `starts` are descended from beside
        the last plan: a plan with controls at their bounds has hardly any gradient, and new starts lead away from it.

        Raises ArgumentError for an unknown method, numbers below 1, more starts than guesses, and an objective that
        cannot be descended.
        """
        check_method(method)
        if min(steps, iterations) < 1:
            raise ArgumentError(
                f"steps and iterations: wanted at least 1, got {steps} and {iterations}."
            )
        if not 0 <= guesses <= MAX_GUESSES:
            raise ArgumentError(f"guesses: wanted 0 to {MAX_GUESSES}, got {guesses}.")
        if not 1 <= starts <= max(1, guesses):
            raise ArgumentError(
                f"starts: wanted 1 to the {max(1, guesses)} guesses, got {starts}. Give more guesses."
            )
        if parametrisation is None:
            parametrisation = EachStep.of(steps, bounds or emulator.bounds)
        if parametrisation.steps != steps:
            raise ArgumentError(
                f"parametrisation: wanted one of {steps} super steps, got {parametrisation.steps}."
            )
        check_objective(objective, emulator, emulator.rest, steps)
        problem = pose_problem(emulator, objective, parametrisation, emulator.rest)
        planner = cls(
            emulator,
            objective,
            parametrisation,
            method,
            iterations,
            starts,
            _guesses(emulator, parametrisation, guesses, seed),
            evaluator_of(problem),
        )
        planner.plan(emulator.rest)
        return planner

    def plan(self, state: np.ndarray, first: np.ndarray | None = None) -> Plan:
        """Return the plan from `state` (S,), searched from controls `first` (T, C), such as the last plan `moved_on`.

        For None the search begins in the middle of the bounds.
        """
        began = time.perf_counter()
        state = self.emulator.state.check(state, "state")
        guess = self.parametrisation.guess(first)
        evaluator = self._evaluator.at(state)
        method = METHODS[self.method]
        starts = [method.begin(guess)]
        if len(self.guesses):
            costs = evaluator.costs(self.guesses)
            order = best_first(costs)
            for best_guess in self.guesses[order[: self.starts]]:
                starts.append(method.begin(best_guess))
        found = advance(method, evaluator, starts, self.iterations)
        progress = min(found, key=lambda end: end.least if np.isfinite(end.least) else np.inf)
        motion = evaluator.motion(progress.best)
        return Plan(motion.controls, motion.states, progress.least, time.perf_counter() - began)

    def towards(self, objective: Objective) -> Planner:
        """Return this planner for an objective of the same costs with other numbers: nothing is recompiled."""
        if not bool(eqx.tree_equal(_without_numbers(objective), _without_numbers(self.objective))):
            raise ArgumentError(
                "objective: only numbers in the planner's costs may change. Make a new planner."
            )
        problem = pose_problem(self.emulator, objective, self.parametrisation, self.emulator.rest)
        return replace(self, objective=objective, _evaluator=evaluator_of(problem))


def _guesses(
    emulator: Emulator, parametrisation: Parametrisation, count: int, seed: int
) -> Float[np.ndarray, "K Z"]:
    """Return `count` initial guesses: half random as in training, half waves."""
    waves = wave_guesses(emulator, parametrisation, count // 2, seed)
    others = random_guesses(emulator, parametrisation, count - count // 2, seed)
    return np.concatenate([others, waves])


def wave_guesses(
    emulator: Emulator, parametrisation: Parametrisation, count: int, seed: int
) -> Float[np.ndarray, "K Z"]:
    """Return the z of `count` waves that run through the controls in order, some of them offset to one side.

    Bodies that swim or crawl move forward by the order in which joints move, which a gradient at rest does not show.
    """
    bounds = emulator.bounds
    rng = np.random.default_rng([seed, WAVES])
    seconds = (np.arange(parametrisation.steps) + 0.5) * emulator.dt
    fastest = min(MAX_WAVE_FREQUENCY, 0.25 / emulator.dt)
    guesses = np.empty((count, parametrisation.size))
    for guess in guesses:
        frequency = fastest * MIN_WAVE_SHARE ** rng.uniform()
        lag = rng.uniform(-np.pi, np.pi)
        height = rng.uniform(MIN_WAVE_HEIGHT, 1)
        bend = rng.integers(0, 2) * rng.uniform(-MAX_BEND, MAX_BEND)
        phases = rng.uniform(0, 2 * np.pi) + lag * np.arange(len(bounds.half))
        wave = height * np.sin(2 * np.pi * frequency * seconds[:, None] + phases) + bend
        guess[:] = parametrisation.guess(bounds.middle + np.clip(wave, -1, 1) * bounds.half)
    return guesses


def _without_numbers(objective: Objective) -> Objective:
    """Return `objective` with its arrays replaced by their shapes."""
    return jax.tree.map(lambda leaf: leaf.shape if eqx.is_array(leaf) else leaf, objective)


def moved_on(controls: Float[np.ndarray, "T C"], steps: int = 1) -> Float[np.ndarray, "T C"]:
    """Return the controls of a plan `steps` super steps later, with the last one held at the end."""
    held = np.repeat(controls[-1:], steps, axis=0)
    return np.concatenate([controls, held])[-len(controls) :]
