"""iLQR in its Gauss-Newton form, on MuJoCo's own derivatives: the baseline that knows the physics from inside."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from benchmarks.control.baselines.budgeted_cost import BudgetedCost
from benchmarks.control.baselines.cost_evaluator import CostEvaluator, Linearisation
from benchmarks.control.baselines.fast_physics import MujocoPhysics, threads
from neuroanimator.codegen.cores import core_count
from neuroanimator.control.descent.methods import (
    DAMPINGS,
    FIRST_DAMPING,
    MAX_DAMPING,
    MIN_DAMPING,
    damped_steps,
)
from neuroanimator.errors import ArgumentError
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.systems.system import Scheme, System

DIFFERENCE = 1e-5
"""Step of MuJoCo's finite differences: at its usual 1e-6 a control turns a body by less than quaternions show."""

MIN_FALL = 1e-3
"""A descent ends, and the next begins elsewhere, where J falls by less than this share of it."""

SPREAD = 0.5
"""Spread of z about the first guess where a further descent begins: the first spread of CMA-ES."""


def is_usable_on(system: System) -> bool:
    """Return whether iLQR can be used: MuJoCo differentiates the physics, by the motors of the model."""
    return isinstance(system, MujocoSystem) and not system.external_forces


def linear_scheme(system: System, scheme: Scheme) -> Scheme:
    """Return `scheme`, or the system's own where MuJoCo cannot differentiate it: RK4.

    Raises ArgumentError for a system iLQR cannot be used on.
    """
    if not is_usable_on(system):
        raise ArgumentError(
            f"ilqr: wanted a MuJoCo system driven by its own motors, got {system.name}."
        )
    if scheme.integrator == "rk4":
        scheme = system.scheme
    if scheme.integrator == "rk4":
        raise ArgumentError("ilqr: MuJoCo has no derivatives of rk4. Give another scheme.")
    return scheme


def ilqr(budget: BudgetedCost, first: Float[np.ndarray, " Z"], rng: np.random.Generator) -> None:
    """Descend from `first`, then from random z about it, until the budget is spent."""
    z = first
    while True:
        _descend(budget, z)
        z = first + SPREAD * rng.normal(size=len(first))


def _descend(budget: BudgetedCost, z: Float[np.ndarray, " Z"]) -> None:
    """Take Levenberg-Marquardt steps from `z` until they win little: what `methods.GaussNewton` does."""
    damping = FIRST_DAMPING
    cost = np.inf
    while True:
        linear = linearised(budget.evaluator, z)
        budget.spend(linearisation_steps(budget.evaluator))
        curvature = linear.jacobian.T @ linear.jacobian
        slope = linear.jacobian.T @ linear.residuals + linear.slope
        if not np.isfinite(curvature).all() or not np.isfinite(slope).all():
            return
        if cost == np.inf:
            cost = budget.cost(z)
        while True:
            dampings = np.clip(damping * np.array(DAMPINGS), MIN_DAMPING, MAX_DAMPING)
            trials = z + damped_steps(curvature, slope, dampings)
            costs = budget.costs(trials)
            best = int(costs.argmin())
            if costs[best] < cost:
                break
            if dampings[-1] >= MAX_DAMPING:
                return
            damping = dampings[-1] * DAMPINGS[-1]
        fall = cost - costs[best]
        z = trials[best]
        cost = costs[best]
        damping = dampings[best]
        if fall < MIN_FALL * (cost + fall):
            return


def linearisation_steps(evaluator: CostEvaluator) -> int:
    """Return how many physics steps a linearisation takes: each twice as it is, and once per number changed."""
    physics = physics_of(evaluator)
    model = physics.model
    return physics.steps * (2 + 2 * model.nv + model.na + model.nu)


def physics_of(evaluator: CostEvaluator) -> MujocoPhysics:
    """Return MuJoCo, which iLQR needs: see `linear_scheme`."""
    assert isinstance(evaluator.physics, MujocoPhysics)
    return evaluator.physics


def linearised(evaluator: CostEvaluator, z: Float[np.ndarray, " Z"]) -> Linearisation:
    """Return J's cost terms about `z`, by MuJoCo's derivatives along the motion."""
    physics = physics_of(evaluator)
    controls = evaluator.controls(z[None])[0]
    slopes = evaluator.slopes(z)
    states = physics.rollout_float64(controls[None])[0]
    changes = _state_changes(physics, states, controls, slopes)
    return evaluator.linearised(states, controls, changes, slopes)


def _state_changes(
    physics: MujocoPhysics,
    states: Float[np.ndarray, "T S"],
    controls: Float[np.ndarray, "T C"],
    slopes: Float[np.ndarray, "Z T C"],
) -> Float[np.ndarray, "Z T S"]:
    """Return how the states change with z, if the controls change by `slopes`.

    Sensors, on which nothing of the motion depends, count as constant.
    """
    before = np.concatenate([physics.start[None], states[:-1]])
    by_state, by_control = super_step_derivatives(physics, before, controls)
    change = np.zeros((by_state.shape[1], len(slopes)))
    state_changes = np.zeros((len(slopes), *states.shape))
    for t, state in enumerate(states):
        change = by_state[t] @ change + by_control[t] @ slopes[:, t].T
        physical_change = _state_by_change(physics.model, state) @ change
        state_changes[:, t, : physics.system.physical_size] = physical_change.T
    return state_changes


def super_step_derivatives(
    physics: MujocoPhysics, states: Float[np.ndarray, "T S"], controls: Float[np.ndarray, "T C"]
) -> tuple[Float[np.ndarray, "T V V"], Float[np.ndarray, "T V C"]]:
    """Return how each super step's end changes with its beginning and with its control.

    A change has V = 2 nv + na numbers: quaternions change as they turn, by three.
    """
    shares = np.array_split(np.arange(len(states)), core_count())

    def derivatives_of(
        data: mujoco.MjData, rows: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        return [_super_step_derivative(physics, data, states[t], controls[t]) for t in rows]

    by_state = []
    by_control = []
    # MuJoCo lets go of Python's lock.
    for share in threads().map(derivatives_of, physics.workers, shares):
        for step_by_state, step_by_control in share:
            by_state.append(step_by_state)
            by_control.append(step_by_control)
    return np.stack(by_state), np.stack(by_control)


def _super_step_derivative(
    physics: MujocoPhysics,
    data: mujoco.MjData,
    state: Float[np.ndarray, " S"],
    control: Float[np.ndarray, " C"],
) -> tuple[Float[np.ndarray, "V V"], Float[np.ndarray, "V C"]]:
    """Return how one super step's end changes with its beginning and with its control: physics steps, chained."""
    model = physics.model
    size = 2 * model.nv + model.na
    step_by_state = np.empty((size, size))
    step_by_control = np.empty((size, model.nu))
    by_state = np.eye(size)
    by_control = np.zeros((size, model.nu))
    physics.system.put(data, state)
    data.ctrl[:] = control
    with warnings_counted:
        for _ in range(physics.substeps):
            mujoco.mjd_transitionFD(
                model, data, DIFFERENCE, False, step_by_state, step_by_control, None, None
            )
            by_state = step_by_state @ by_state
            by_control = step_by_state @ by_control + step_by_control
            mujoco.mj_step(model, data)
    return by_state, by_control


def _state_by_change(
    model: mujoco.MjModel, state: Float[np.ndarray, " S"]
) -> Float[np.ndarray, "P V"]:
    """Return how the P = nq + nv + na numbers of `state` change with the V numbers of a change."""
    positions = np.eye(model.nq, model.nv)
    if model.nq != model.nv:
        base = np.array(state[: model.nq])
        directions = np.eye(model.nv)
        for i, direction in enumerate(directions):
            moved = base.copy()
            mujoco.mj_integratePos(model, moved, direction, DIFFERENCE)
            positions[:, i] = (moved - base) / DIFFERENCE
    derivative = np.eye(
        model.nq + model.nv + model.na, 2 * model.nv + model.na, model.nv - model.nq
    )
    derivative[: model.nq] = 0
    derivative[: model.nq, : model.nv] = positions
    return derivative
