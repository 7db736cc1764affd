"""What a motion should achieve."""

from __future__ import annotations

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Objective(eqx.Module):
    """J = μ_u/2 Σ|u|² + μ_s/2 |s_{M+1} - s_d|², the seminar paper's eq. 11.

    Efforts are summed over time and measured against the control's limit, end states against
    `scale`, so that the weights are plain numbers and J does not depend on the super step.
    """

    goal: Float[Array, " S"]
    scale: Float[Array, " S"]
    """What counts as an error of one, per state entry and in its unit."""
    combine: Float[Array, "S S"]
    """Turns a state into the numbers compared, such as joint angles into angles against gravity."""
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
        off = self.combine @ (states[-1] - self.goal) / self.scale
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
    sums = jnp.tril(jnp.ones((3, 3)))
    return Objective(
        goal=jnp.array([math.pi, 0.0, 0.0, 0.0, 0.0, 0.0]),
        scale=jnp.array([UPRIGHT_ANGLE] * 3 + [UPRIGHT_SPEED] * 3),
        combine=jnp.block([[sums, jnp.zeros((3, 3))], [jnp.zeros((3, 3)), sums]]),
        effort_weight=effort_weight,
        state_weight=state_weight,
    )


GOALS = {"upright": stand_upright}
