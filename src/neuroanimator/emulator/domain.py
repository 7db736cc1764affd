"""The training domain: the range of every raw feature in training."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.state.arrays import AnyArray

MARGIN = 0.02
"""Share of its range by which a feature may leave it if only ranges are known: samples seldom touch the ends."""

MIN_MARGIN = 1e-6
"""Minimum margin: features that never varied have an empty range."""


class Domain(eqx.Module):
    """The range of every raw feature (velocities, the frame's numbers, controls) in training."""

    low: Float[AnyArray, " K"]
    high: Float[AnyArray, " K"]

    def widened(
        self, margin: float, entries: slice
    ) -> tuple[Float[AnyArray, " P"], Float[AnyArray, " P"]]:
        """Return the ends of the range of `entries`, widened by `margin` times the range on each side."""
        low = self.low[entries]
        high = self.high[entries]
        room = margin * (high - low)
        return low - room, high + room

    def clip(self, features: Float[Array, " K"]) -> Float[Array, " K"]:
        """Return `features` clipped to their ranges, so that the network sees nothing it was not trained on."""
        return jnp.clip(features, self.low, self.high)

    @property
    def margin(self) -> Float[Array, " K"]:
        """Distance by which each feature may leave its range if only ranges are known."""
        return jnp.maximum(MARGIN * (self.high - self.low), MIN_MARGIN)
