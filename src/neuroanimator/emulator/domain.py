"""The range of every raw feature that training showed, and what lies within it."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.state.arrays import AnyArray

MARGIN = 0.02
"""Share of its range by which a number may leave it where nothing but ranges is known: samples seldom touch their ends."""

LEAST_MARGIN = 1e-6
"""Least of these margins: what never varied has no range."""


class Domain(eqx.Module):
    """The range of every raw feature (velocities, the frame's numbers, controls) seen in training."""

    low: Float[AnyArray, " K"]
    high: Float[AnyArray, " K"]

    def widened(
        self, margin: float, entries: slice
    ) -> tuple[Float[AnyArray, " P"], Float[AnyArray, " P"]]:
        """Return the ends of the range of some `entries`, further apart by `margin` times the range on each side."""
        low = self.low[entries]
        high = self.high[entries]
        room = margin * (high - low)
        return low - room, high + room

    def clip(self, features: Float[Array, " K"]) -> Float[Array, " K"]:
        """Return `features` with every entry brought into the range: what the network never saw, it is not shown."""
        return jnp.clip(features, self.low, self.high)

    @property
    def margin(self) -> Float[Array, " K"]:
        """How far each feature may leave its range where nothing but ranges is known."""
        return jnp.maximum(MARGIN * (self.high - self.low), LEAST_MARGIN)
