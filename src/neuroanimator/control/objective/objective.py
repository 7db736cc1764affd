"""What a motion should achieve: an objective J, the sum of weighted cost terms (the seminar paper's eqs. 9 to 11).

Terms of the package, and so J, are written once for arrays of NumPy and JAX alike; other costs are functions of JAX.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from typing import ClassVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray


class CostTerm(eqx.Module):
    """One thing a motion should do. It costs half the sum of squares of its residuals, times its weight."""

    weight: Float[AnyArray, ""]
    of_controls: ClassVar[bool] = False
    """Whether residuals depend on nothing but the controls: they can be differentiated without the emulator."""

    @abc.abstractmethod
    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        """Return numbers that are zero where the motion does it, and one where it is off by a sizeable error."""


class StateTerm(CostTerm):
    """A term that looks at single states of a motion: it observes each for itself, and compares what it saw.

    So generated C observes states as it goes, and whole states, which are hundreds of numbers, need not be made.
    """

    @abc.abstractmethod
    def rows(self, steps: int, dt: float) -> Sequence[int]:
        """Return the states it looks at, of a motion of `steps` super steps of `dt` [s]; 0 is the start, -1 the end."""

    @abc.abstractmethod
    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B O"]:
        """Return what it looks at in a state (S,), or in each of many (..., S)."""

    @abc.abstractmethod
    def compare(self, observed: Float[AnyArray, "K O"], dt: float) -> Float[AnyArray, " R"]:
        """Return the residuals of what was `observed` of the states at `rows`, `dt` [s] apart."""

    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        rows = checked_rows(self, len(trajectory.states) - 1, trajectory.dt)
        states = trajectory.states[rows]
        if isinstance(states, jax.Array):
            observed = jax.vmap(self.observe)(states)
        else:
            observed = self.observe(states)
        return self.compare(observed, trajectory.dt)


def checked_rows(term: StateTerm, steps: int, dt: float) -> Int[np.ndarray, " K"]:
    """Return the `rows` of a term, counted from the start; ArgumentError for states a motion does not have."""
    rows = np.array(term.rows(steps, dt), int)
    beyond = rows[(rows < -steps - 1) | (rows > steps)]
    if len(beyond):
        raise ArgumentError(
            f"objective: {type(term).__name__} looks at state {beyond[0]} of a motion with states 0 to {steps}. "
            "Make the motion longer, or mend the term's rows."
        )
    return rows % (steps + 1)


CostFunction = Callable[[Trajectory], Float[AnyArray, ""]]
"""A cost of one's own: any differentiable JAX function that makes one number of a trajectory, weight included."""


class Objective(eqx.Module):
    """J(trajectory) = Σ weight/2 |residuals|² + Σ functions."""

    terms: tuple[CostTerm, ...]
    functions: tuple[CostFunction, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.terms, tuple) or not isinstance(self.functions, tuple):
            raise ArgumentError(
                "Objective: wanted tuples of terms and of functions. Objective.of(effort(), ...) takes costs one by one."
            )

    @classmethod
    def of(cls, *costs: CostTerm | CostFunction) -> Objective:
        """Return the objective that sums `costs`; ArgumentError for an objective among them."""
        for cost in costs:
            if isinstance(cost, Objective):
                raise ArgumentError(
                    f"objective: wanted cost terms and functions, came {cost!r} within another objective. "
                    "Give what it is made of: *objective.terms, *objective.functions."
                )
        terms = tuple(cost for cost in costs if isinstance(cost, CostTerm))
        functions = tuple(cost for cost in costs if not isinstance(cost, CostTerm))
        return cls(terms, functions)

    def __repr__(self) -> str:
        names = [type(term).__name__ for term in self.terms]
        names += [name_of(function) for function in self.functions]
        return f"Objective({', '.join(names)})"

    def apart(self) -> tuple[Objective, Objective]:
        """Return the terms that look at states, and those of controls alone; without functions."""
        of_states = tuple(term for term in self.terms if not term.of_controls)
        of_controls = tuple(term for term in self.terms if term.of_controls)
        return Objective(of_states), Objective(of_controls)

    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        """Return the numbers whose squares sum to 2J, but for the functions."""
        trajectory = trajectory.beside(jax.tree.leaves(self))
        xp = trajectory.states.__array_namespace__()
        parts = [xp.sqrt(term.weight) * term.residuals(trajectory) for term in self.terms]
        return xp.concat([xp.zeros(0, dtype=trajectory.states.dtype), *parts])

    def extra(self, trajectory: Trajectory) -> Float[AnyArray, ""]:
        """Return what the functions add to J."""
        no_cost = trajectory.states.__array_namespace__().zeros(())
        return sum((function(trajectory) for function in self.functions), no_cost)

    def __call__(self, trajectory: Trajectory) -> Float[AnyArray, ""]:
        """Return J of a trajectory and the controls that made it."""
        residuals = self.residuals(trajectory)
        return (residuals**2).sum() / 2 + self.extra(trajectory)


def name_of(function: CostFunction) -> str:
    """Return the name of a cost function of a user's, for messages."""
    return getattr(function, "__name__", type(function).__name__)
