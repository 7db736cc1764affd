"""The cost of leaving the emulator's training: it keeps optimisation from exploiting the emulator's errors."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.objective.objective import Trajectory
from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import trust
from neuroanimator.emulator.trust import EDGE
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray

WEIGHT = 10.0
"""Default weight: a second at a score of 1 above the threshold costs ten times as much as a sizeable error at a goal."""


class StayTrusted(eqx.Module):
    """μ/2 ∫ max(0, score - threshold)² dt, by the scores of `Emulator.trust`; a function, so its curvature is not known.

    Like any cost it is a function of states, those of the physics as well as the emulator's.
    """

    emulator: Emulator
    threshold: Float[AnyArray, ""]
    weight: Float[AnyArray, ""]

    def __call__(self, trajectory: Trajectory) -> Float[Array, ""]:
        """Return the cost of the trajectory's super steps."""
        states, controls = jnp.asarray(trajectory.states), jnp.asarray(trajectory.controls)
        scores = jax.vmap(lambda state, control: trust(self.emulator, state, control))(
            states[:-1], controls
        )
        excess = jnp.maximum(scores - self.threshold, 0)
        return self.weight / 2 * trajectory.dt * jnp.sum(excess**2)


def stay_trusted(
    emulator: Emulator, *, threshold: float = EDGE, weight: float = WEIGHT
) -> StayTrusted:
    """Return the cost of super steps whose score is above `threshold`; 1 is the edge of training.

    Raises ArgumentError for a threshold that is not above 0, and for an emulator without scores.
    """
    if not 0 < threshold < np.inf:  # NaN is refused too
        raise ArgumentError(
            f"threshold: wanted a score above 0, got {threshold}. 1 is the edge of training."
        )
    if emulator.meter is None:
        raise ArgumentError(
            "threshold: this emulator's file is too old to have trust scores. na.fit_trust(emulator, data) adds them."
        )
    return StayTrusted(emulator, as_parameter(threshold), as_parameter(weight))
