"""J with a budget: evaluations are counted and timed, the best is kept, and a search ends at its target or its time."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from benchmarks.control.baselines.cost_evaluator import CostEvaluator


class BudgetSpent(Exception):  # noqa: N818
    """The target is reached, or the time is up."""


@dataclass(frozen=True)
class Improvement:
    """When a search's best became better."""

    seconds: float
    physics_steps: int
    cost: float
    z: Float[np.ndarray, " Z"]


class BudgetedCost:
    """J of z, until it is at most `target` or `seconds` are over. The clock runs from the making of this object on."""

    def __init__(self, evaluator: CostEvaluator, target: float, seconds: float):
        self.evaluator = evaluator
        self.target = target
        self.best: np.ndarray | None = None
        """The best z (Z,) so far."""
        self.curve: list[Improvement] = []
        """Whenever the best became better."""
        self.physics_steps = 0
        self.evaluations = 0
        self._max_seconds = seconds
        self._began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Time since the beginning."""
        return time.perf_counter() - self._began

    @property
    def is_reached(self) -> bool:
        """Whether J has come to the target or below."""
        return bool(self.curve) and self.curve[-1].cost <= self.target

    def cost(self, z: Float[np.ndarray, " Z"]) -> float:
        """Return J of `z`. Raises BudgetSpent once the target is reached or the time is up."""
        return float(self.costs(z[None])[0])

    def costs(self, zs: Float[np.ndarray, "B Z"]) -> Float[np.ndarray, " B"]:
        """Return J of any number of `zs`. Raises BudgetSpent once the target is reached or the time is up."""
        batch = self.evaluator.batch
        parts = [self._costs(zs[first : first + batch]) for first in range(0, len(zs), batch)]
        return np.concatenate(parts)

    def _costs(self, zs: Float[np.ndarray, "B Z"]) -> Float[np.ndarray, " B"]:
        costs = self.evaluator.costs(zs)
        self.evaluations += len(zs)
        self.physics_steps += len(zs) * self.evaluator.physics.steps
        best = int(costs.argmin())
        if not self.curve or costs[best] < self.curve[-1].cost:
            self.best = np.array(zs[best], float)
            improvement = Improvement(
                self.seconds, self.physics_steps, float(costs[best]), self.best
            )
            self.curve.append(improvement)
        self.spend(0)
        return costs

    def spend(self, physics_steps: int) -> None:
        """Count physics steps taken for other ends than J. Raises BudgetSpent as `costs` does."""
        self.physics_steps += physics_steps
        if self.is_reached or self.seconds >= self._max_seconds:
            raise BudgetSpent
