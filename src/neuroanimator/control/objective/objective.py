"""What a motion should achieve: an objective J, the sum of weighted cost terms (the seminar paper's eqs. 9 to 11).

Terms of the package, and so J, are written once for arrays of NumPy and JAX alike; other costs are functions of JAX.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from neuroanimator.backend import backend
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.arrays import as_float32, as_jax
from neuroanimator.emulator.emulator import Emulator
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
        names += [_name_of(function) for function in self.functions]
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


def objective_cost(
    objective: Objective, emulator: Emulator, states: np.ndarray, controls: np.ndarray
) -> float:
    """Return J of `states` (T+1, S) under `controls` (T, C), by the `backend`."""
    in_c = _in_c(objective, emulator, len(controls))
    if in_c is not None:
        return in_c.cost(as_float32(states), as_float32(controls))
    control_scale = as_jax(emulator.bounds.magnitude)
    motion = Trajectory(as_jax(states), as_jax(controls), control_scale, emulator.dt)
    return float(_cost(objective, motion))


@eqx.filter_jit
def _cost(objective: Objective, trajectory: Trajectory) -> Array:
    return objective(trajectory)


def _in_c(objective: Objective, emulator: Emulator, steps: int) -> Any:
    """Return the `CObjective` that judges motions of so many super steps, if the `backend` is C and there is one."""
    if backend() == "jax":
        return None
    # It is written in terms of this module.
    from neuroanimator.control.objective.c_objective import c_objective

    return c_objective(objective, emulator, steps, as_float32(emulator.bounds.magnitude))


def check_objective(
    objective: Objective, emulator: Emulator, start: np.ndarray, steps: int
) -> None:
    """Raise ArgumentError where `objective` cannot be descended: said before any descent."""
    weights = [float(term.weight) for term in objective.terms]
    if any(not 0 <= weight < math.inf for weight in weights):
        raise ArgumentError(
            f"objective: wanted weights of at least 0, came {min(weights, key=_rank):g}."
        )
    if not objective.functions and not any(weights):
        raise ArgumentError(
            "objective: every weight is zero, so every motion is as good. Give a term a weight."
        )
    for term in objective.terms:
        check_times(term, steps, emulator.dt)
    cost, slopes = _of_resting(objective, emulator, start, steps)
    if not np.isfinite(cost):
        raise ArgumentError(
            "objective: J of staying at the start is not finite. Mend the term that makes it."
        )
    if not all(np.isfinite(slope).all() for slope in slopes):
        raise ArgumentError(
            "objective: J has no finite slope, like a square root at zero. Smooth the term that makes it."
        )


def _of_resting(
    objective: Objective, emulator: Emulator, start: np.ndarray, steps: int
) -> tuple[Any, tuple[Any, Any]]:
    """Return J and its slopes of a motion that stays at its start; its functions are tried first."""
    in_c = _in_c(objective, emulator, steps)
    if in_c is not None:
        states = np.broadcast_to(start, (steps + 1, len(start)))
        controls = np.broadcast_to(emulator.bounds.middle, (steps, emulator.control.size))
        return in_c.cost_and_slopes(as_float32(states), as_float32(controls))
    trajectory = _resting(emulator, start, steps)
    for function in objective.functions:
        _check_function(function, trajectory)
    return cost_and_slopes(objective, trajectory)


@eqx.filter_jit
def cost_and_slopes(
    objective: Objective, trajectory: Trajectory
) -> tuple[Array, tuple[Array, Array]]:
    """Return J, and how it changes with the states (T+1, S) and with the controls (T, C)."""

    def cost(states: Array, controls: Array) -> Array:
        return objective(trajectory._replace(states=states, controls=controls))

    return jax.value_and_grad(cost, (0, 1))(trajectory.states, trajectory.controls)


def _rank(weight: float) -> float:
    return -math.inf if math.isnan(weight) else weight


def check_times(term: CostTerm, steps: int, dt: float) -> None:
    """Raise ArgumentError if `term` wants something at a time [s] beyond the horizon of `steps` super steps."""
    when = getattr(term, "when", None)
    latest = max(getattr(when, "times", ()) or (0.0,))
    if latest > (steps + 0.5) * dt:
        raise ArgumentError(
            f"objective: something is wanted at {latest:g} s, but the motion lasts {steps * dt:g} s. Make it longer."
        )


def _name_of(function: CostFunction) -> str:
    return getattr(function, "__name__", type(function).__name__)


def _check_function(function: CostFunction, trajectory: Trajectory) -> None:
    name = _name_of(function)
    try:
        shape = jax.eval_shape(function, trajectory)
    except Exception as error:  # whatever a user's function may raise
        raise ArgumentError(
            f"objective: '{name}' failed: {type(error).__name__}: {error}"
        ) from error
    if not hasattr(shape, "shape") or shape.shape != ():
        came = getattr(shape, "shape", type(shape).__name__)
        raise ArgumentError(
            f"objective: '{name}' must return one number, came {came}. Sum or average it."
        )


def _resting(emulator: Emulator, start: np.ndarray, steps: int) -> Trajectory:
    """Return a motion that stays at its start: enough to try an objective on, and there without compiling."""
    bounds = emulator.bounds
    states = as_jax(np.broadcast_to(start, (steps + 1, len(start))))
    controls = as_jax(np.broadcast_to(bounds.middle, (steps, len(bounds.middle))))
    return Trajectory(states, controls, as_jax(bounds.magnitude), emulator.dt)
