"""Hold a body at a goal that fixes its whole state: the linear-quadratic regulator of super steps linearised there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_discrete_are

from neuroanimator.control.objective.goals import (
    ERRORS_PER_TOLERANCE,
    ReachState,
    is_reached,
    reach_goal,
)
from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.errors import DivergedError
from neuroanimator.learn.planning.plants import drive
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.goal import Goal
from neuroanimator.systems.plants import Plant
from neuroanimator.systems.system import System

MAX_DRIFT = 0.1
"""Maximum change in a super step of a state that can be held, over the goal's tolerances."""

SMALL = 1e-3
"""Step of finite differences, for controls as a share of their bounds: small, and far above rounding."""

TRIED_STEPS = 100
"""Number of super steps after which a held body must be at its goal."""


@dataclass(frozen=True)
class Regulator:
    """u = u* - K δ within the bounds, where δ is the state's difference from the goal's; made by `regulator_of`."""

    plant: Plant
    """Plant to hold."""
    system: System
    goal: Goal
    bounds: Bounds
    reach: ReachState
    """Cost of not being at the goal."""
    control: Float[np.ndarray, " C"]
    """u*, which holds the goal's state."""
    gain: Float[np.ndarray, "C V"]
    """K."""
    cost_matrix: Float[np.ndarray, "V V"]
    """P: δᵀ P δ / 2 is the J needed to reach the goal from δ, as far as super steps are linear."""

    def __call__(self, state: Float[np.ndarray, " S"]) -> Float[np.ndarray, " C"]:
        """Return the control (C,) for `state` (S,)."""
        off = self.reach.frame.difference(np.asarray(self.reach.goal, float), state)
        return self.bounds.clip(self.control - self.gain @ off)

    def cost_to_go(self) -> ReachState:
        """Return the cost-to-go at the end of a motion: that of reaching the goal from there and staying."""
        factor = np.linalg.cholesky(self.cost_matrix).T
        return replace(self.reach, judged=as_parameter(factor))

    def holds(self, state: Float[np.ndarray, " S"]) -> bool:
        """Return whether the plant, regulated from `state` (S,), is at the goal after `TRIED_STEPS`."""
        try:
            held = drive(self.plant, state, lambda _, state: self(state), TRIED_STEPS)
        except DivergedError:
            return False
        return is_reached(self.system, self.goal, held.states[-1])


def regulator_of(
    plant: Plant, system: System, goal: Goal, bounds: Bounds, dt: float, effort_weight: float
) -> Regulator | None:
    """Return a regulator that holds `plant`, whose super step is `dt` [s], at `goal`; None if there is none.

    There is none if the goal leaves part of the state free, or is not an equilibrium.
    The plant is linearised at the goal by central differences, which take a few super steps.
    The running weights are those of `goal_objective`: Q = dt WᵀW with the goal's weights W, R = dt `effort_weight` / scale².
    K and P solve the discrete algebraic Riccati equation (Anderson and Moore, Optimal Control, 1990).
    """
    reach = reach_goal(system, goal)
    weights = np.asarray(reach.judged, float)
    if np.linalg.matrix_rank(weights) < weights.shape[1]:
        return None
    frame = reach.frame
    target = np.asarray(reach.goal, float)
    point = jax.numpy.asarray(target)
    seen = np.asarray(jax.jacfwd(lambda state: frame.difference(point, state))(point), float)
    directions = np.linalg.pinv(seen).T
    idle = bounds.idle
    half = np.asarray(bounds.half, float)

    def drift(change: np.ndarray, control: np.ndarray) -> Float[np.ndarray, " V"]:
        return frame.difference(target, plant(target + change, control))

    still = np.zeros_like(target)
    pulls = SMALL * np.diag(half)
    try:
        by_state = [drift(SMALL * way, idle) - drift(-SMALL * way, idle) for way in directions]
        by_control = [drift(still, idle + pull) - drift(still, idle - pull) for pull in pulls]
        state_matrix = np.transpose(by_state) / (2 * SMALL)
        control_matrix = np.transpose(by_control) / (2 * SMALL * half)
        held = idle - np.linalg.lstsq(control_matrix, drift(still, idle), rcond=None)[0]
        held = bounds.clip(held)
        if not np.abs(weights @ drift(still, held)).max() <= MAX_DRIFT * ERRORS_PER_TOLERANCE:
            return None
        effort = dt * effort_weight * np.diag(1 / half**2)
        cost = solve_discrete_are(state_matrix, control_matrix, dt * weights.T @ weights, effort)
        np.linalg.cholesky(cost)
    except (DivergedError, np.linalg.LinAlgError, ValueError):
        return None
    inverse = effort + control_matrix.T @ cost @ control_matrix
    gain = np.linalg.solve(inverse, control_matrix.T @ cost @ state_matrix)
    return Regulator(plant, system, goal, bounds, reach, held, gain, cost)
