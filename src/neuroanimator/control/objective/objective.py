"""The objective J of a motion, a sum of weighted cost terms (the seminar paper's eqs. 9 to 11).

The package's terms, and so J, work with NumPy and JAX arrays alike; other costs are JAX functions.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray


class Trajectory(NamedTuple):
    """States and the controls that led from each to the next, on emulator or physics: all JAX arrays, or all NumPy's."""

    states: Float[AnyArray, "T+1 S"]
    controls: Float[AnyArray, "T C"]
    control_scale: Float[AnyArray, " C"]
    """Magnitude of each control that counts as full effort."""
    dt: float
    """Time from one state to the next [s]."""

    def beside(self, numbers: Iterable[Any]) -> Trajectory:
        """Return it with JAX arrays if any of its own arrays, or any of `numbers`, is one."""
        arrays = (self.states, self.controls, self.control_scale)
        if not any(isinstance(array, jax.Array) for array in (*arrays, *numbers)):
            return self
        states, controls, control_scale = map(jnp.asarray, arrays)
        return Trajectory(states, controls, control_scale, self.dt)


class CostTerm(eqx.Module):
    """One requirement on a motion. It costs half the sum of squares of its residuals, times its weight."""

    weight: Float[AnyArray, ""]
    of_controls: ClassVar[bool] = False
    """Whether residuals depend on the controls alone: they can then be differentiated without the emulator."""

    @abc.abstractmethod
    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        """Return numbers that are zero if the requirement is met, and one at a sizeable error."""


class StateTerm(CostTerm):
    """A term that looks at single states of a motion: it observes each one separately, and compares the observations.

    So generated C observes states as it goes, and whole states, which are hundreds of numbers, need not be computed.
    """

    @abc.abstractmethod
    def rows(self, steps: int, dt: float) -> Sequence[int]:
        """Return the states it looks at in a motion of `steps` super steps of `dt` [s]; 0 is the start, -1 the end."""

    @abc.abstractmethod
    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B O"]:
        """Return the observation of a state (S,), or of each of several (..., S)."""

    @abc.abstractmethod
    def compare(self, observed: Float[AnyArray, "K O"], dt: float) -> Float[AnyArray, " R"]:
        """Return the residuals of the observations at `rows`; states are `dt` [s] apart."""

    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        rows = checked_rows(self, len(trajectory.states) - 1, trajectory.dt)
        states = trajectory.states[rows]
        if isinstance(states, jax.Array):
            observed = jax.vmap(self.observe)(states)
        else:
            observed = self.observe(states)
        return self.compare(observed, trajectory.dt)


def checked_rows(term: StateTerm, steps: int, dt: float) -> Int[np.ndarray, " K"]:
    """Return the `rows` of a term, counted from the start; ArgumentError for states that a motion does not have."""
    rows = np.array(term.rows(steps, dt), int)
    beyond = rows[(rows < -steps - 1) | (rows > steps)]
    if len(beyond):
        raise ArgumentError(
            f"objective: {type(term).__name__} looks at state {beyond[0]} of a motion with states 0 to {steps}. "
            "Make the motion longer, or correct the term's rows."
        )
    return rows % (steps + 1)


@dataclass(frozen=True)
class Moments:
    """States of a motion that a term looks at: those at given times, the last one without any, or all since a time."""

    times: tuple[float, ...] = ()
    """Times [s]."""
    lasts: bool = False
    """Whether all states from the one time on count, so that residuals are a sum over time."""

    @classmethod
    def of(cls, at: float | tuple[float, ...] | None = None, since: float | None = None) -> Moments:
        """Return the moments at `at`, one time or several [s], or all from `since` [s] on; the end if neither is given.

        Raises ArgumentError for both, and for times that are negative or not finite.
        """
        if at is not None and since is not None:
            raise ArgumentError(f"at and since: wanted one of them, got {at} and {since:g} s.")
        if since is not None:
            return cls((_time("since", since),), lasts=True)
        if at is None:
            return cls()
        times = at if isinstance(at, tuple) else (at,)
        return cls(tuple(_time("at", time) for time in times))

    def rows(self, steps: int, dt: float) -> list[int]:
        """Return the indices of these states in a motion of `steps` super steps of `dt` [s]; `lasts` excludes the start."""
        rows = [round(time / dt) for time in self.times]
        if not self.lasts:
            return rows or [steps]
        first = max(1, min(*rows, steps))
        return list(range(first, steps + 1))

    def share(self, dt: float) -> float:
        """Return the factor of residuals that makes a sum over time independent of the super step."""
        return math.sqrt(dt) if self.lasts else 1.0


AT_THE_END = Moments()
"""The last state alone."""

ALL_ALONG = Moments((0.0,), lasts=True)
"""Every state but the start."""


def _time(label: str, seconds: float) -> float:
    if not 0 <= seconds < math.inf:
        raise ArgumentError(f"{label}: wanted a time of at least 0 s, got {seconds:g}.")
    return float(seconds)


class TimedTerm(StateTerm):
    """A term that looks at the states at given moments."""

    when: Moments = eqx.field(static=True)

    def rows(self, steps: int, dt: float) -> list[int]:
        return self.when.rows(steps, dt)


CostFunction = Callable[[Trajectory], Float[AnyArray, ""]]
"""A user's cost: any differentiable JAX function of a trajectory that returns one number, weight included."""


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
                    f"objective: wanted cost terms and functions, got {cost!r} within another objective. "
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
        """Return the terms of states, and those of controls alone; without functions."""
        of_states = tuple(term for term in self.terms if not term.of_controls)
        of_controls = tuple(term for term in self.terms if term.of_controls)
        return Objective(of_states), Objective(of_controls)

    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        """Return the numbers whose squares sum to 2J, without the functions."""
        trajectory = trajectory.beside(jax.tree.leaves(self))
        xp = trajectory.states.__array_namespace__()
        parts = [xp.sqrt(term.weight) * term.residuals(trajectory) for term in self.terms]
        return xp.concat([xp.zeros(0, dtype=trajectory.states.dtype), *parts])

    def extra(self, trajectory: Trajectory) -> Float[AnyArray, ""]:
        """Return the functions' share of J."""
        no_cost = trajectory.states.__array_namespace__().zeros(())
        return sum((function(trajectory) for function in self.functions), no_cost)

    def __call__(self, trajectory: Trajectory) -> Float[AnyArray, ""]:
        """Return J of a trajectory and the controls that made it."""
        residuals = self.residuals(trajectory)
        return (residuals**2).sum() / 2 + self.extra(trajectory)


def name_of(function: CostFunction) -> str:
    """Return the name of a user's cost function, for messages."""
    return getattr(function, "__name__", type(function).__name__)
