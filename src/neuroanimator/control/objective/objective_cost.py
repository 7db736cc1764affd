"""J of motions and its gradients, computed by generated C or by JAX; checks of an objective before a descent."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from neuroanimator.codegen.backend import backend
from neuroanimator.control.objective.c_objective import CObjective, c_objective
from neuroanimator.control.objective.objective import (
    CostFunction,
    CostTerm,
    Objective,
    Trajectory,
    name_of,
)
from neuroanimator.emulator.arrays import as_float32, as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError


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


_cost = eqx.filter_jit(Objective.__call__)


def _in_c(objective: Objective, emulator: Emulator, steps: int) -> CObjective | None:
    """Return the objective in C for motions of `steps` super steps, if the `backend` is C and there is one."""
    if backend() == "jax":
        return None
    return c_objective(objective, emulator, steps, as_float32(emulator.bounds.magnitude))


def check_objective(
    objective: Objective, emulator: Emulator, start: np.ndarray, steps: int
) -> None:
    """Raise ArgumentError if `objective` cannot be descended."""
    weights = [float(term.weight) for term in objective.terms]
    if any(not 0 <= weight < math.inf for weight in weights):
        raise ArgumentError(f"objective: wanted weights of at least 0, got {np.min(weights):g}.")
    if not objective.functions and not any(weights):
        raise ArgumentError(
            "objective: every weight is zero, so all motions are equally good. Give a term a weight."
        )
    for term in objective.terms:
        check_times(term, steps, emulator.dt)
    cost, slopes = _of_resting(objective, emulator, start, steps)
    if not np.isfinite(cost):
        raise ArgumentError(
            "objective: J of staying at the start is not finite. Correct the term that causes it."
        )
    if not all(np.isfinite(slope).all() for slope in slopes):
        raise ArgumentError(
            "objective: J has no finite gradient, like a square root at zero. Smooth the term that causes it."
        )


def _of_resting(
    objective: Objective, emulator: Emulator, start: np.ndarray, steps: int
) -> tuple[Any, tuple[Any, Any]]:
    """Return J and its gradients for a motion that stays at its start; its functions are tried first."""
    bounds = emulator.bounds
    states = as_float32(np.broadcast_to(start, (steps + 1, len(start))))
    controls = as_float32(np.broadcast_to(bounds.middle, (steps, len(bounds.middle))))
    in_c = _in_c(objective, emulator, steps)
    if in_c is not None:
        return in_c.cost_and_slopes(states, controls)
    trajectory = Trajectory(as_jax(states), as_jax(controls), as_jax(bounds.magnitude), emulator.dt)
    for function in objective.functions:
        _check_function(function, trajectory)
    return cost_and_slopes(objective, trajectory)


@eqx.filter_jit
def cost_and_slopes(
    objective: Objective, trajectory: Trajectory
) -> tuple[Array, tuple[Array, Array]]:
    """Return J and its gradients by the states (T+1, S) and by the controls (T, C)."""

    def cost(states: Array, controls: Array) -> Array:
        return objective(trajectory._replace(states=states, controls=controls))

    return jax.value_and_grad(cost, (0, 1))(trajectory.states, trajectory.controls)


def check_times(term: CostTerm, steps: int, dt: float) -> None:
    """Raise ArgumentError if `term` wants something at a time [s] beyond the horizon of `steps` super steps."""
    when = getattr(term, "when", None)
    latest = max(getattr(when, "times", ()) or (0.0,))
    if latest > (steps + 0.5) * dt:
        raise ArgumentError(
            f"objective: a term applies at {latest:g} s, but the motion lasts {steps * dt:g} s. Make it longer."
        )


def _check_function(function: CostFunction, trajectory: Trajectory) -> None:
    name = name_of(function)
    try:
        shape = jax.eval_shape(function, trajectory)
    except Exception as error:  # a user's function may raise anything
        raise ArgumentError(
            f"objective: '{name}' failed: {type(error).__name__}: {error}"
        ) from error
    if not hasattr(shape, "shape") or shape.shape != ():
        given = getattr(shape, "shape", type(shape).__name__)
        raise ArgumentError(
            f"objective: '{name}' must return one number, got {given}. Sum or average it."
        )
