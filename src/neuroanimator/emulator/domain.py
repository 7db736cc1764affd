"""The range of every raw feature that training showed, and what lies within it."""

from __future__ import annotations

from jaxtyping import Bool, Float

from neuroanimator.jax_later import Array, jnp
from neuroanimator.pytrees import Module
from neuroanimator.state.arrays import AnyArray

COVERED_MARGIN = 0.02
"""Share of its range by which a number may leave it and still count as covered: samples seldom
touch the ends of their range."""


class Domain(Module):
    """The range of every raw feature (velocities, the frame's numbers, controls) seen in training."""

    low: Float[AnyArray, " K"]
    high: Float[AnyArray, " K"]

    def covers(self, features: Float[AnyArray, "*B P"]) -> Bool[AnyArray, "*B"]:
        """Return whether every entry of `features` (..., P), the first P ones, lies in the range or near it."""
        xp = features.__array_namespace__()
        low, high = self.widened(COVERED_MARGIN, slice(features.shape[-1]))
        is_inside = (features >= xp.asarray(low)) & (features <= xp.asarray(high))
        return xp.all(is_inside, axis=-1)

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
