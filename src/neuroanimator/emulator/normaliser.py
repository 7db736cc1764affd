"""Normalisation of the network's inputs and outputs to order one."""

from __future__ import annotations

import equinox as eqx
from jaxtyping import Array, Float

from neuroanimator.state.arrays import AnyArray

MIN_CHANGE = 1e-6
"""Minimum change in a super step, in its unit, of a number that moves: less is rounding, which must not be learnt."""


class Normaliser(eqx.Module):
    """Means and standard deviations of the plain features and of the predicted change.

    For odd motions both means are zero, so that the symmetry stays exact. Numbers that never move have a
    `change_scale` and a `unit` of zero: they change by their mean, whatever the network answers, and add no error.
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
