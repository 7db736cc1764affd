"""What a motion should achieve."""

from __future__ import annotations

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.frame import Frame
from neuroanimator.systems.structure import Segment, Structure
from neuroanimator.systems.system import Goal, System


class Objective(eqx.Module):
    """J = μ_u/2 Σ|u|² + μ_s/2 |s_{M+1} - s_d|², the seminar paper's eq. 11.

    Efforts are summed over time and measured against the control's limit, end states against
    what counts as an error of one, so that the weights are plain numbers and J does not depend on
    the super step. The end state is compared as seen from the goal: in a parking bay, lengthwise
    and sideways.
    """

    frame: Frame
    goal: Float[Array, " S"]
    compare: Float[Array, "R V"]
    """Turns the difference from the goal into numbers of which one is a sizeable error."""
    effort_weight: float = eqx.field(static=True)
    state_weight: float = eqx.field(static=True)

    def residuals(
        self,
        states: Float[Array, "T+1 S"],
        controls: Float[Array, "T C"],
        limit: Float[Array, " C"],
        dt: float,
    ) -> Float[Array, " R"]:
        """Return the numbers whose squares sum to 2J: efforts, then end-state errors."""
        effort = math.sqrt(self.effort_weight * dt) * (controls / limit).ravel()
        off = self.compare @ self.frame.difference(self.goal, states[-1])
        return jnp.concatenate([effort, math.sqrt(self.state_weight) * off])

    def __call__(
        self,
        states: Float[Array, "T+1 S"],
        controls: Float[Array, "T C"],
        limit: Float[Array, " C"],
        dt: float,
    ) -> Float[Array, ""]:
        """Return J of a trajectory and the controls that made it."""
        return jnp.sum(self.residuals(states, controls, limit, dt) ** 2) / 2


UPRIGHT_ANGLE = 0.1
"""[rad] An angle error that counts as one: a third of the 10° that still count as upright."""
UPRIGHT_SPEED = 0.5
"""[rad/s] A speed error that counts as one: half of what still counts as at rest."""


def stand_upright(effort_weight: float = 1.0, state_weight: float = 1.0) -> Objective:
    """Return the objective 'all three links point up and stand still at the end' of the pendulum."""
    sums, zeros = jnp.tril(jnp.ones((3, 3))), jnp.zeros((3, 3))
    return Objective(
        frame=Frame((), (), 0.0),
        goal=jnp.array([math.pi, 0.0, 0.0, 0.0, 0.0, 0.0]),
        compare=jnp.block([[sums / UPRIGHT_ANGLE, zeros], [zeros, sums / UPRIGHT_SPEED]]),
        effort_weight=effort_weight,
        state_weight=state_weight,
    )


def reach_state(
    structure: Structure, rest: np.ndarray, goal: Goal, effort_weight: float = 1.0, state_weight: float = 1.0
) -> Objective:
    """Return the objective 'be in the state `goal` names at the end'; entries it does not name are free.

    A third of a goal's tolerance counts as an error of one.
    """
    frame = Frame.of(structure, 0.0)
    target = goal_state(rest, goal)
    weights = 3 * tangent_weights(frame, len(rest), goal)
    compare = np.diag(weights)[weights > 0]
    return Objective(
        frame, jnp.asarray(target, jnp.float32), jnp.asarray(compare, jnp.float32), effort_weight, state_weight
    )


def goal_state(rest: np.ndarray, goal: Goal) -> np.ndarray:
    """Return `rest` (S,) with the goal's entries in their places."""
    target = np.array(rest, dtype=float)
    for entry, value in goal.values:
        target[entry] = value
    return target


def tangent_weights(frame: Frame, size: int, goal: Goal) -> np.ndarray:
    """Return (V,) one over the goal's tolerance for each number of a change; zero where anything will do."""
    wanted = {entry: tolerance for (entry, _), tolerance in zip(goal.values, goal.tolerances, strict=True)}
    weights, start = [], 0
    for segment in frame.segments or (Segment("plain", size),):
        entries = range(start, start + segment.change_size)
        weights += [1 / wanted[entry] if entry in wanted else 0.0 for entry in entries]
        start += segment.size
    return np.array(weights)


def is_reached(system: System, goal: Goal, state: np.ndarray) -> bool:
    """Return whether `state` (S,) is within the tolerances of `goal`."""
    frame = Frame.of(system.structure, 0.0)
    off = frame.difference(goal_state(system.rest, goal), state) * tangent_weights(frame, len(state), goal)
    return bool((np.abs(off) <= 1).all())


GOALS = {"upright": stand_upright}
