"""Baselines of the emulator: searches for the same controls on the true physics itself.

Each is run until it reaches a given J or its time is up, on the fastest physics we have: `fast_physics`. Compiling and
importing are not counted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from jaxtyping import ArrayLike, Float

from benchmarks.control.baselines.budgeted_cost import BudgetedCost, BudgetSpent, Improvement
from benchmarks.control.baselines.cost_evaluator import CostEvaluator
from benchmarks.control.baselines.derivative_free import cma_es, nelder_mead, simulated_annealing
from benchmarks.control.baselines.fast_physics import cheapest_scheme, fast_physics, side_by_side
from benchmarks.control.baselines.genetic import genetic_algorithm
from benchmarks.control.baselines.ilqr import ilqr, linear_scheme
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.objective.objective import Objective
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.system import Scheme, System

SEED_STREAM = 13
"""A baseline's random numbers come from a stream of their own: the seed with this number."""

Baseline = Callable[[BudgetedCost, np.ndarray, np.random.Generator], None]
"""(budgeted J, first guess z (Z,), random numbers): searches, anew where it is stuck, until the budget is spent."""

BASELINES: dict[str, Baseline] = {
    "annealing": simulated_annealing,
    "cma-es": cma_es,
    "genetic": genetic_algorithm,
    "ilqr": ilqr,
    "nelder-mead": nelder_mead,
}


@dataclass(frozen=True)
class BaselineRun:
    """How far a baseline came."""

    name: str
    scheme: Scheme
    """How it stepped the physics."""
    controls: Float[np.ndarray, "T C"]
    """The best found."""
    cost: float
    """Their J on this physics."""
    curve: tuple[Improvement, ...]
    """Whenever the best became better."""
    is_reached: bool
    """Whether J came to the target or below."""
    reached_seconds: float | None
    """Time after which it did; None where it did not."""
    reached_steps: int | None
    """Physics steps taken when it did; None where it did not."""
    seconds: float
    """Time of the whole run."""
    physics_steps: int
    """Physics steps of the whole run."""
    evaluations: int
    """Number of evaluations of J."""

    @property
    def spent_seconds(self) -> float:
        """Time until the target was reached; of the whole run where it was not."""
        return self.reached_seconds or self.seconds

    @property
    def spent_steps(self) -> int:
        """Physics steps until the target was reached; of the whole run where it was not."""
        return self.reached_steps or self.physics_steps


def run_baseline(
    name: str,
    system: System,
    objective: Objective,
    parametrisation: Parametrisation,
    dt: float,
    start: ArrayLike,
    *,
    target: float,
    seconds: float,
    seed: int = 0,
    control_scale: Float[np.ndarray, " C"] | None = None,
    scheme: Scheme | None = None,
    first: Float[np.ndarray, "T C"] | None = None,
) -> BaselineRun:
    """Return how the baseline called `name` fares from `start` (S,) until J is at most `target`, or `seconds` are over.

    J is the emulator's: of states `dt` [s] apart; `control_scale` counts as full effort, by default the largest
    controls within the system's bounds. The first guess is `first`, or the middle of the bounds. `scheme` steps the
    physics, by default `cheapest_scheme`, which is measured: give one to get the same run again. The time ends a
    run after the evaluation, population or linearisation it is at.

    Raises ArgumentError for an unknown name, and for systems iLQR cannot be used on.
    """
    if name not in BASELINES:
        raise ArgumentError(
            f"No baseline called '{name}'. Baselines: {', '.join(sorted(BASELINES))}."
        )
    start = system.state.check(start, "state")
    if control_scale is None:
        control_scale = system.bounds.magnitude
    scheme = scheme or cheapest_scheme(system, dt, start)
    if name == "ilqr":
        scheme = linear_scheme(system, scheme)
    batch = population(parametrisation.size, side_by_side(system))
    physics = fast_physics(system, scheme, dt, start, parametrisation.steps, batch)
    evaluator = CostEvaluator(physics, objective, parametrisation, dt, start, control_scale, batch)
    guess = parametrisation.guess(first)
    _warm_up(name, evaluator, guess)
    budget = BudgetedCost(evaluator, target, seconds)
    with suppress(BudgetSpent):
        budget.cost(guess)
        BASELINES[name](budget, guess, np.random.default_rng([seed, SEED_STREAM]))
    return _summary(name, scheme, budget)


def population(size: int, together: int) -> int:
    """Return how many z of `size` numbers CMA-ES should try at a time: its own choice, and full lanes or cores."""
    return math.ceil((4 + 3 * math.log(size)) / together) * together


def _warm_up(name: str, evaluator: CostEvaluator, guess: Float[np.ndarray, " Z"]) -> None:
    """Compile and import what the run will need: a run of no time does."""
    evaluator.costs(guess[None])
    evaluator.costs(np.tile(guess, (evaluator.batch, 1)))
    without_time = BudgetedCost(evaluator, -math.inf, 0.0)
    with suppress(BudgetSpent):
        BASELINES[name](without_time, guess, np.random.default_rng(0))


def _summary(name: str, scheme: Scheme, budget: BudgetedCost) -> BaselineRun:
    assert budget.best is not None
    last = budget.curve[-1]
    return BaselineRun(
        name=name,
        scheme=scheme,
        controls=budget.evaluator.controls(budget.best[None])[0].astype(float),
        cost=last.cost,
        curve=tuple(budget.curve),
        is_reached=budget.is_reached,
        reached_seconds=last.seconds if budget.is_reached else None,
        reached_steps=last.physics_steps if budget.is_reached else None,
        seconds=budget.seconds,
        physics_steps=budget.physics_steps,
        evaluations=budget.evaluations,
    )
