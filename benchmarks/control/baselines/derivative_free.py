"""Baselines that need J alone: simulated annealing, CMA-ES, and the simplex of Nelder and Mead.

Each begins anew where it is stuck, until the budget is spent.
"""

from __future__ import annotations

import math
import sys
import warnings

import numpy as np
from jaxtyping import Float

from benchmarks.control.baselines.budgeted_cost import BudgetedCost

MAX_DISTANCE = 2.0
"""Annealing looks for z between minus this and this: controls up to 96 % of the way to their bounds."""

DIFFERENCE = 1e-3
"""Step of z for slopes of J in annealing's local searches: J is float32, so a smaller one finds rounding."""

SPREAD = 0.5
"""Spread of z about the first guess: of the first population of CMA-ES, and edges of the first simplex of Nelder-Mead."""

MIN_FALL = 1e-3
"""A search ends and begins anew where J falls by less, and a simplex where z differs by less."""

MANY_NUMBERS = 100
"""With more numbers than this, CMA-ES learns only their variances at first: all covariances of 360 numbers take 30 ms a
population, the physics of 32 fish 4 ms."""

DIAGONAL_POPULATIONS = "100*N/popsize**0.5"
"""Number of populations for which CMA-ES learns variances only, if there are many numbers: what cma's author proposes."""

SILENT = -9
"""cma's verbosity at which it prints nothing."""


def simulated_annealing(
    budget: BudgetedCost, first: Float[np.ndarray, " Z"], rng: np.random.Generator
) -> None:
    """Search by generalised annealing (Xiang et al. 1997) with local searches, their slopes by populations of differences."""
    from scipy.optimize import dual_annealing

    def slope(z: np.ndarray) -> np.ndarray:
        neighbours = z + DIFFERENCE * np.eye(len(z))
        costs = budget.costs(np.concatenate([z[None], neighbours]))
        return (costs[1:] - costs[0]) / DIFFERENCE

    bounds = [(-MAX_DISTANCE, MAX_DISTANCE)] * len(first)
    local_search = {"method": "L-BFGS-B", "jac": slope, "bounds": bounds}
    begin = np.clip(first, -MAX_DISTANCE, MAX_DISTANCE)
    while True:
        dual_annealing(
            budget.cost,
            bounds,
            x0=begin,
            rng=rng,
            minimizer_kwargs=local_search,
            maxiter=sys.maxsize,
        )


def cma_es(budget: BudgetedCost, first: Float[np.ndarray, " Z"], rng: np.random.Generator) -> None:
    """Search by CMA-ES (Hansen), begun anew with twice the population where it is stuck."""
    from cma import CMAEvolutionStrategy

    options = {
        # cma's own seeds would set NumPy's global random numbers.
        "seed": math.nan,
        "randn": lambda *shape: rng.standard_normal(shape),
        "verbose": SILENT,
        "verb_log": 0,
        "tolfun": MIN_FALL,
        "CMA_diagonal": 0,
        "popsize": budget.evaluator.batch,
    }
    if len(first) > MANY_NUMBERS:
        options["CMA_diagonal"] = DIAGONAL_POPULATIONS
    # cma warns of outliers, which it deals with itself.
    with warnings.catch_warnings(category=UserWarning, action="ignore"):
        while True:
            search = CMAEvolutionStrategy(first, SPREAD, dict(options))
            while not search.stop():
                zs = np.array(search.ask())
                costs = budget.costs(zs)
                search.tell(list(zs), list(costs))
            options["popsize"] *= 2


def nelder_mead(
    budget: BudgetedCost, first: Float[np.ndarray, " Z"], rng: np.random.Generator
) -> None:
    """Search by the simplex of Nelder and Mead, adapted to many numbers; begun anew about the best where it has shrunk."""
    from scipy.optimize import minimize

    while True:
        begin = first if budget.best is None else budget.best
        edges = np.diag(SPREAD * rng.choice([-1.0, 1.0], len(first)))
        simplex = np.concatenate([begin[None], begin + edges])
        corners = [corner.tobytes() for corner in simplex]
        known = dict(zip(corners, budget.costs(simplex), strict=True))

        def cost(z: np.ndarray, known: dict[bytes, float] = known) -> float:
            """Return J of `z`; that of the first simplex is known already, from one batch."""
            key = z.tobytes()
            if key in known:
                return known.pop(key)
            return budget.cost(z)

        options = {
            "adaptive": True,
            "initial_simplex": simplex,
            "xatol": MIN_FALL,
            "fatol": MIN_FALL,
            "maxiter": math.inf,
            "maxfev": math.inf,
        }
        minimize(cost, begin, method="Nelder-Mead", options=options)
