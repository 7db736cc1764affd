"""A genetic algorithm among the baselines: plain, as in a textbook, with numbers as genes.

Parents win tournaments, children are blends of two parents (Eshelman and Schaffer, 1993) and mutate; the best survive.
It begins anew where all are alike, until the budget is spent.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from benchmarks.control.baselines.budgeted_cost import BudgetedCost

GENERATION = 64
"""Least number of individuals: fewer lose their variety within a few generations."""

TOURNAMENT = 3
"""Number of individuals of which the best becomes a parent."""

BLEND = 0.5
"""Share of the parents' distance by which a child may lie beyond either of them (BLX-0.5)."""

MUTATED_GENES = 2.0
"""Mean number of genes of a child that mutate."""

MUTATION = 0.3
"""Standard deviation of a mutation, in z."""

SURVIVORS = 2
"""Number of the best that live on unchanged."""

FIRST_SPREAD = 0.5
"""Standard deviation of z about the first guess in the first generation: that of the other baselines."""

MAX_GENE = 2.0
"""Genes lie between minus this and this: controls up to 96 % of the way to their bounds, as annealing's."""

MIN_VARIETY = 1e-3
"""Relative spread of J within a generation below which all are alike."""


def genetic_algorithm(
    budget: BudgetedCost, first: Float[np.ndarray, " Z"], rng: np.random.Generator
) -> None:
    """Search by generations of at least `GENERATION` individuals, as many as fill whole batches."""
    batch = budget.evaluator.batch
    count = -(-GENERATION // batch) * batch
    while True:
        spread = FIRST_SPREAD * rng.normal(size=(count, len(first)))
        genes = np.clip(first + spread, -MAX_GENE, MAX_GENE)
        costs = budget.costs(genes)
        while np.ptp(costs) > MIN_VARIETY * abs(costs.min()):
            children = children_of(genes, costs, rng)
            best = np.argsort(costs)[:SURVIVORS]
            children_costs = budget.costs(children)
            genes = np.concatenate([genes[best], children])[:count]
            costs = np.concatenate([costs[best], children_costs])[:count]


def children_of(
    genes: Float[np.ndarray, "N Z"], costs: Float[np.ndarray, " N"], rng: np.random.Generator
) -> Float[np.ndarray, "N Z"]:
    """Return as many children as there are individuals."""
    mothers = genes[winners(costs, rng)]
    fathers = genes[winners(costs, rng)]
    shares = rng.uniform(-BLEND, 1 + BLEND, genes.shape)
    children = mothers + shares * (fathers - mothers)
    does_mutate = rng.random(genes.shape) < MUTATED_GENES / genes.shape[1]
    children += does_mutate * MUTATION * rng.normal(size=genes.shape)
    return np.clip(children, -MAX_GENE, MAX_GENE)


def winners(costs: Float[np.ndarray, " N"], rng: np.random.Generator) -> np.ndarray:
    """Return the rows of the winners (N,) of as many tournaments."""
    entrants = rng.integers(0, len(costs), (len(costs), TOURNAMENT))
    best = costs[entrants].argmin(axis=1)
    return entrants[np.arange(len(costs)), best]
