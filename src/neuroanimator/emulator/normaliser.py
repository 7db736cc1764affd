"""Numbers of order one in, numbers of order one out."""

from __future__ import annotations

import equinox as eqx
from jaxtyping import Array, Float

from neuroanimator.state.arrays import AnyArray

MIN_CHANGE = 1e-6
"""[of its unit] What changes by less in a super step never moves: rounding would be taken for motion, and learnt."""


class Normaliser(eqx.Module):
    """Means and standard deviations of the plain features and of the predicted change.

    Where the motion is odd both means are zero, so that the symmetry stays exact. What never moves has a
    `change_scale` and a `unit` of zero: it changes by its mean, whatever the network says, and makes no error.
    """

    plain_mean: Float[AnyArray, " K"]
    plain_scale: Float[AnyArray, " K"]
    change_mean: Float[AnyArray, " V"]
    change_scale: Float[AnyArray, " V"]
    unit: Float[AnyArray, " V"]
    """Standard deviation of the whole change in one super step, coasting included: the unit of errors."""

    def forward(self, plain: Float[Array, " K"]) -> Float[Array, " K"]:
        """Return plain features of order one."""
        return (plain - self.plain_mean) / self.plain_scale

    def inverse(self, change: Float[Array, " V"]) -> Float[Array, " V"]:
        """Return the change in its own units."""
        return self.change_mean + self.change_scale * change
