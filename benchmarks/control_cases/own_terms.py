"""Cost terms of one's own beside the package's: the same residuals, written by a user, in one descent's evaluations."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator import Objective, load_emulator, load_system
from neuroanimator.control.descent.descend import evaluator_of, pose_problem
from neuroanimator.control.descent.evaluator import Evaluator
from neuroanimator.control.objective.objective import CostFunction, CostTerm, StateTerm, Trajectory
from neuroanimator.control.tasks.solver import Solver
from neuroanimator.control.tasks.task import Task

SIDE_BY_SIDE = 16
"""Number of costs asked for at once."""

SPREAD = 0.1
"""Standard deviation of z about the first guess."""


class OwnStateTerm(StateTerm):
    """A term of a user's own that looks at single states, with the residuals of one of the package's."""

    weight: Float[Array, ""]
    inner: StateTerm

    def rows(self, steps: int, dt: float) -> list[int]:
        return self.inner.rows(steps, dt)

    def observe(self, state: Float[Array, "*B S"]) -> Float[Array, "*B O"]:
        return self.inner.observe(state)

    def compare(self, observed: Float[Array, "K O"], dt: float) -> Float[Array, " R"]:
        return self.inner.compare(observed, dt)


class OwnTerm(CostTerm):
    """A term of a user's own of whole motions, with the same residuals."""

    weight: Float[Array, ""]
    inner: StateTerm

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        return self.inner.residuals(trajectory)


def own_function(inner: StateTerm) -> CostFunction:
    """Return a cost that is a user's function, with the same value; its curvature is not known."""

    def cost(trajectory: Trajectory) -> Float[Array, ""]:
        return inner.weight / 2 * jnp.sum(inner.residuals(trajectory) ** 2)

    return cost


WRITTEN_AS: dict[str, Callable[[StateTerm], CostTerm | CostFunction]] = {
    "package's terms": lambda term: term,
    "own terms of states": lambda term: OwnStateTerm(term.weight, term),
    "own terms of motions": lambda term: OwnTerm(term.weight, term),
    "own functions": own_function,
}


def own_rows(tasks: list[Task], rounds: int) -> list[dict[str, Any]]:
    """Return a row per task and way of writing its terms: the least time of each evaluation, taken in turn."""
    rows = []
    for task in tasks:
        rows += _rows_of(task, rounds)
    return rows


def _rows_of(task: Task, rounds: int) -> list[dict[str, Any]]:
    emulator = load_emulator(f"{task.system}-{task.substeps}")
    solver = Solver.of(task, load_system(task.system), emulator)
    trial = solver.draw(0)
    parametrisation = solver.parametrisation
    guess = parametrisation.guess(trial.first)
    noise = np.random.default_rng(0).normal(size=(SIDE_BY_SIDE, len(guess)))
    zs = guess + SPREAD * noise
    evaluators = {}
    cold = {}
    for name, write in WRITTEN_AS.items():
        costs = []
        for term in trial.objective.terms:
            costs.append(write(term) if isinstance(term, StateTerm) else term)
        problem = pose_problem(emulator, Objective.of(*costs), parametrisation, trial.start)
        began = time.perf_counter()
        evaluators[name] = evaluator_of(problem)
        cold[name] = time.perf_counter() - began
    least = {name: dict.fromkeys(EVALUATIONS, np.inf) for name in WRITTEN_AS}
    for _ in range(rounds):
        for name, evaluator in evaluators.items():
            for kind, evaluate in EVALUATIONS.items():
                began = time.perf_counter()
                evaluate(evaluator, zs)
                least[name][kind] = min(least[name][kind], time.perf_counter() - began)
    ours = least["package's terms"]
    rows = []
    for name in WRITTEN_AS:
        row: dict[str, Any] = {
            "task": task.name,
            "written_as": name,
            "runs_in": type(evaluators[name]).__name__,
            "seconds_to_first": cold[name],
        }
        for kind in EVALUATIONS:
            row[f"{kind}_ms"] = 1e3 * least[name][kind]
            row[f"{kind}_over_packages"] = least[name][kind] / ours[kind]
        rows.append(row)
    return rows


EVALUATIONS: dict[str, Callable[[Evaluator, np.ndarray], Any]] = {
    "quadratic_model": lambda evaluator, zs: evaluator.quadratic_models(zs[:1]),
    "gradient": lambda evaluator, zs: evaluator.gradients(zs[:1]),
    "costs": lambda evaluator, zs: evaluator.costs(zs),
}
"""What methods of descent ask for."""
