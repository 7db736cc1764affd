"""Find controls from any state in milliseconds, with nothing left to compile."""

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
from neuroanimator.control.descent.methods import METHODS
from neuroanimator.control.descent.options import DEFAULT_METHOD, check_method
from neuroanimator.control.descent.parametrisation import EachStep, Parametrisation
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.objective_cost import check_objective
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Bounds

ITERATIONS = 2
"""Backward sweeps a plan: the last plan, moved on, is nearly optimal already. They swing the pendulum up and hold it."""

WAVES = 13
"""Joins the seed of waves, so that they are not drawn as anything else."""

MAX_WAVE_FREQUENCY = 1.5
"""Waves are no faster [Hz], nor than a quarter of a period a super step."""

MIN_WAVE_SHARE = 0.1
"""Waves are no slower than this share of the fastest."""

MIN_WAVE_HEIGHT = 0.4
"""Waves take at least this share of the controls' range to either side."""

MAX_BEND = 0.5
"""By at most this share of the range to one side half of the waves are bent, so that they turn."""

MAX_GUESSES = 4096
"""Random controls tried at every plan, at most: J of each takes as long as a rollout."""


@dataclass(frozen=True)
class Plan:
    """The best controls found from one state."""

    controls: np.ndarray
    """(T, C) within the bounds."""
    states: np.ndarray
    """(T+1, S) the emulated motion under them."""
    cost: float
    """J on the emulator."""
    seconds: float
    """From the measured state to the controls."""


@dataclass(frozen=True)
class Planner:
    """Finds controls from any state, with nothing left to compile; made by `Planner.of`."""

    emulator: Emulator
    objective: Objective
    parametrisation: Parametrisation
    method: str
    iterations: int
    """Backward sweeps of a plan, at most."""
    starts: int
    """Number of guesses that are descended from, beside the last plan."""
    guesses: Float[np.ndarray, "K Z"] = field(repr=False)
    """Controls tried at every plan, as numbers of the parametrisation."""
    _evaluator: Evaluator = field(repr=False)
    """Of motions from the emulator's rest."""

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
        """Return a planner that looks `steps` super steps ahead, compiled: some seconds.

        Times in `objective` count from the state planned from, so a goal `since` 0 s is one to stay at. `bounds`
        may be tighter than the emulator's own; `parametrisation` other than one value per super step bring their own.
        Of so many `guesses`, random ones and waves, the same at every plan, the best so many `starts` are descended from beside
        the last plan: a plan whose controls are at their bounds has hardly a slope, and a new beginning leads away from there.

        Raises ArgumentError for an unknown method, numbers below 1, more starts than guesses, and an objective that
        cannot be descended.
        """
        check_method(method)
        if min(steps, iterations) < 1:
            raise ArgumentError(
                f"steps and iterations: wanted at least 1, came {steps} and {iterations}."
            )
        if not 0 <= guesses <= MAX_GUESSES:
            raise ArgumentError(f"guesses: wanted 0 to {MAX_GUESSES}, came {guesses}.")
        if not 1 <= starts <= max(1, guesses):
            raise ArgumentError(
                f"starts: wanted 1 to the {max(1, guesses)} guesses, came {starts}. Give more guesses."
            )
        if parametrisation is None:
            parametrisation = EachStep.of(steps, bounds or emulator.bounds)
        if parametrisation.steps != steps:
            raise ArgumentError(
                f"parametrisation: wanted one of {steps} super steps, came {parametrisation.steps}."
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

        The search begins in the middle of the bounds for None.
        """
        began = time.perf_counter()
        state = self.emulator.state.check(state, "state")
        guess = self.parametrisation.guess(first)
        evaluator = self._evaluator.at(state)
        method = METHODS[self.method]
        starts = [method.begin(guess)]
        if len(self.guesses):
            costs = evaluator.costs(self.guesses)
            order = np.argsort(np.where(np.isfinite(costs), costs, np.inf))
            for best_guess in self.guesses[order[: self.starts]]:
                starts.append(method.begin(best_guess))
        found = advance(method, evaluator, starts, self.iterations)
        progress = min(found, key=lambda end: end.least if np.isfinite(end.least) else np.inf)
        motion = evaluator.motion(progress.best)
        return Plan(motion.controls, motion.states, progress.least, time.perf_counter() - began)

    def towards(self, objective: Objective) -> Planner:
        """Return this planner for an objective of the same costs with other numbers: nothing is compiled anew."""
        if not bool(eqx.tree_equal(_without_numbers(objective), _without_numbers(self.objective))):
            raise ArgumentError(
                "objective: wanted the planner's costs with other numbers. Make a new planner."
            )
        problem = pose_problem(self.emulator, objective, self.parametrisation, self.emulator.rest)
        return replace(self, objective=objective, _evaluator=evaluator_of(problem))


def _guesses(
    emulator: Emulator, parametrisation: Parametrisation, count: int, seed: int
) -> Float[np.ndarray, "K Z"]:
    """Return `count` first guesses: half random as training saw them, half waves."""
    waves = wave_guesses(emulator, parametrisation, count // 2, seed)
    others = random_guesses(emulator, parametrisation, count - count // 2, seed)
    return np.concatenate([others, waves])


def wave_guesses(
    emulator: Emulator, parametrisation: Parametrisation, count: int, seed: int
) -> Float[np.ndarray, "K Z"]:
    """Return the z of `count` waves that run through the controls in their order, some of them bent to one side.

    Bodies that swim or crawl come forward by the order in which joints move: a slope at rest knows nothing of that.
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
    """Return `objective` with the shapes of its arrays in their places."""
    return jax.tree.map(lambda leaf: leaf.shape if eqx.is_array(leaf) else leaf, objective)


def moved_on(controls: Float[np.ndarray, "T C"], steps: int = 1) -> Float[np.ndarray, "T C"]:
    """Return the controls of a plan one super step later, or several: the last one is held so long."""
    held = np.repeat(controls[-1:], steps, axis=0)
    return np.concatenate([controls, held])[-len(controls) :]
