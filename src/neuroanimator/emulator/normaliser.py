"""Numbers of order one in, numbers of order one out."""

from __future__ import annotations

import equinox as eqx
from jaxtyping import Array, Float


class Normaliser(eqx.Module):
    """Means and standard deviations of the plain features and of the change of state.

    Where the motion is odd both means are zero, so that the symmetry stays exact.
    """

    plain_mean: Float[Array, " K"]
    plain_scale: Float[Array, " K"]
    change_mean: Float[Array, " S"]
    change_scale: Float[Array, " S"]

    def forward(self, plain: Float[Array, " K"]) -> Float[Array, " K"]:
        """Return plain features of order one."""
        return (plain - self.plain_mean) / self.plain_scale

    def inverse(self, change: Float[Array, " S"]) -> Float[Array, " S"]:
        """Return the change of state in its own units."""
        return self.change_mean + self.change_scale * change
