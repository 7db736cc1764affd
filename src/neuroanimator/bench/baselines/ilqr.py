"""iLQR in its Gauss-Newton form, on MuJoCo's own derivatives: the rival that knows the physics from inside."""

from __future__ import annotations

import mujoco
import numpy as np

from neuroanimator.bench.baselines.budgeted_cost import Contest, CostEvaluator
from neuroanimator.bench.baselines.fast_physics import MujocoPhysics, threads
from neuroanimator.control.descent.methods import DAMPINGS, FIRST_DAMPING, MAX_DAMPING, MIN_DAMPING
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.cores import core_count
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.rigid.warnings import warnings_counted
from neuroanimator.systems.system import Scheme, System

DIFFERENCE = 1e-5
"""Step of MuJoCo's finite differences: at its usual 1e-6 a control turns a body by less than quaternions show."""
SETTLED = 1e-3
"""Relative fall of J below which a descent ends, and the next begins elsewhere."""
SPREAD = 0.5
"""Of z about the first guess where a further descent begins: the first spread of CMA-ES."""


def linear_scheme(system: System, scheme: Scheme) -> Scheme:
    """Return `scheme`, or the system's own where MuJoCo cannot differentiate it: RK4.

    Raises ArgumentError for a system iLQR cannot be used on.
    """
    if not isinstance(system, MujocoSystem) or system.external_forces:
        raise ArgumentError(
            f"ilqr: wanted a MuJoCo system driven by its own motors, came {system.name}."
        )
    found = system.scheme if scheme.integrator == "rk4" else scheme
    if found.integrator == "rk4":
        raise ArgumentError("ilqr: MuJoCo has no derivatives of rk4. Give another scheme.")
    return found


def ilqr(contest: Contest, first: np.ndarray, rng: np.random.Generator) -> None:
    """Descend from `first` (Z,), then from random places about it, until the race is over."""
    z = first
    while True:
        _descend(contest, z)
        z = first + SPREAD * rng.normal(size=len(first))


def _descend(contest: Contest, z: np.ndarray) -> None:
    """Take Levenberg-Marquardt steps from `z` (Z,) until they win little: what `methods.GaussNewton` does."""
    damping, least = FIRST_DAMPING, np.inf
    while True:
        residuals, jacobian, extra = linearised(contest.pricing, z)
        contest.spend(linearisation_steps(contest.pricing))
        curvature, slope = jacobian.T @ jacobian, jacobian.T @ residuals + extra
        if not np.isfinite(curvature).all() or not np.isfinite(slope).all():
            return
        least = contest.cost(z) if least == np.inf else least
        while True:
            dampings = np.clip(damping * np.array(DAMPINGS), MIN_DAMPING, MAX_DAMPING)
            trials = z - _steps(curvature, slope, dampings)
            costs = contest.costs(trials)
            k = int(costs.argmin())
            if costs[k] < least:
                break
            if dampings[-1] >= MAX_DAMPING:
                return
            damping = dampings[-1] * DAMPINGS[-1]
        fall, z, least, damping = least - costs[k], trials[k], costs[k], dampings[k]
        if fall < SETTLED * (least + fall):
            return


def _steps(curvature: np.ndarray, slope: np.ndarray, dampings: np.ndarray) -> np.ndarray:
    """Return the damped steps (K, Z)."""
    size, unit = np.trace(curvature) / len(slope) + np.finfo(float).tiny, np.eye(len(slope))
    return np.linalg.solve(curvature + dampings[:, None, None] * size * unit, slope[None, :, None])[
        ..., 0
    ]


def linearisation_steps(pricing: CostEvaluator) -> int:
    """Return how many physics steps a linearisation takes: each twice as it is, and once per number changed."""
    physics = physics_of(pricing)
    model = physics.model
    return physics.steps * (2 + 2 * model.nv + model.na + model.nu)


def physics_of(pricing: CostEvaluator) -> MujocoPhysics:
    """Return MuJoCo, which iLQR needs: see `linear_scheme`."""
    assert isinstance(pricing.physics, MujocoPhysics)
    return pricing.physics


def linearised(pricing: CostEvaluator, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the residuals (R,) of J at `z` (Z,), their derivatives (R, Z), and the slope (Z,) of what is no square."""
    physics, controls, slopes = physics_of(pricing), pricing.controls(z[None])[0], pricing.slopes(z)
    states = physics.roll(controls[None])[0]
    return pricing.linearised(states, controls, _changes(physics, states, controls, slopes), slopes)


def _changes(
    physics: MujocoPhysics, states: np.ndarray, controls: np.ndarray, slopes: np.ndarray
) -> np.ndarray:
    """Return how `states` (T, S) change with z, (Z, T, S), if `controls` (T, C) change by `slopes` (Z, T, C).

    Sensors, on which nothing of the motion depends, count as constant.
    """
    before = np.concatenate([physics.start[None], states[:-1]])
    by_state, by_control = super_step_derivatives(physics, before, controls)
    change = np.zeros((by_state.shape[1], len(slopes)))
    found = np.zeros((len(slopes), *states.shape))
    for t, state in enumerate(states):
        change = by_state[t] @ change + by_control[t] @ slopes[:, t].T
        found[:, t, : physics.system.physical_size] = (_unfolded(physics.model, state) @ change).T
    return found


def super_step_derivatives(
    physics: MujocoPhysics, states: np.ndarray, controls: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how each super step's end changes with its beginning (T, V, V) and its control (T, V, C).

    A change has V = 2 nv + na numbers: quaternions change as they turn, by three.
    """
    shares = np.array_split(np.arange(len(states)), core_count())

    def share(data: mujoco.MjData, rows: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        return [_super_step(physics, data, states[t], controls[t]) for t in rows]

    # MuJoCo lets go of Python's lock.
    found = [pair for part in threads().map(share, physics.workers, shares) for pair in part]
    by_state, by_control = zip(*found, strict=True)
    return np.stack(by_state), np.stack(by_control)


def _super_step(
    physics: MujocoPhysics, data: mujoco.MjData, state: np.ndarray, control: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    model = physics.model
    size = 2 * model.nv + model.na
    one_state, one_control = np.empty((size, size)), np.empty((size, model.nu))
    by_state, by_control = np.eye(size), np.zeros((size, model.nu))
    physics.system.put(data, state)
    data.ctrl[:] = control
    with warnings_counted:
        for _ in range(physics.substeps):
            mujoco.mjd_transitionFD(
                model, data, DIFFERENCE, False, one_state, one_control, None, None
            )
            by_state, by_control = one_state @ by_state, one_state @ by_control + one_control
            mujoco.mj_step(model, data)
    return by_state, by_control


def _unfolded(model: mujoco.MjModel, state: np.ndarray) -> np.ndarray:
    """Return how the numbers of `state` change with the V numbers of a change, (P, V)."""
    positions = np.eye(model.nq, model.nv)
    if model.nq != model.nv:
        base, along = np.array(state[: model.nq]), np.eye(model.nv)
        for i in range(model.nv):
            moved = base.copy()
            mujoco.mj_integratePos(model, moved, along[i], DIFFERENCE)
            positions[:, i] = (moved - base) / DIFFERENCE
    found = np.eye(model.nq + model.nv + model.na, 2 * model.nv + model.na, model.nv - model.nq)
    found[: model.nq] = 0
    found[: model.nq, : model.nv] = positions
    return found
