"""Normalisation of the network's inputs and outputs to order one."""

from __future__ import annotations

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from neuroanimator.emulator.arrays import zeros
from neuroanimator.state.arrays import AnyArray

MIN_CHANGE = 1e-6
"""Minimum change in a super step, in its unit, of a number that moves: less is rounding, which must not be learnt."""

MIN_VARIATION = 1e-4
"""Minimum standard deviation of the change in a super step, over its mean, of a number whose change varies: that of a clock
does not, apart from rounding."""


def varies(
    mean: Float[np.ndarray, "*B V"], deviation: Float[np.ndarray, "*B V"]
) -> Bool[np.ndarray, "*B V"]:
    """Return whether the change of each number, of this mean and standard deviation, is more than a constant and rounding."""
    return deviation >= np.maximum(MIN_CHANGE, MIN_VARIATION * np.abs(mean))


class Normaliser(eqx.Module):
    """Means and standard deviations of the plain features and of the predicted change.

    For odd motions both means are zero, so that the symmetry stays exact. Numbers whose change is
    always the same, such as a clock and what never moves, have a `change_scale` and a `unit` of zero: they change by their
    mean, whatever the network answers, and add no error.
    """

    plain_mean: Float[AnyArray, " K"]
    plain_scale: Float[AnyArray, " K"]
    change_mean: Float[AnyArray, " V"]
    change_scale: Float[AnyArray, " V"]
    unit: Float[AnyArray, " V"]
    """Standard deviation of the whole change in one super step, coasting included: the unit of errors."""

    @classmethod
    def blank(cls, features: int, changes: int) -> Normaliser:
        """Return a blank normaliser of so many plain features and changes, for a file to fill."""
        return cls(zeros(features), zeros(features), zeros(changes), zeros(changes), zeros(changes))

    def forward(self, plain: Float[Array, " K"]) -> Float[Array, " K"]:
        """Return plain features of order one."""
        return (plain - self.plain_mean) / self.plain_scale

    def inverse(self, change: Float[Array, " V"]) -> Float[Array, " V"]:
        """Return the change in its own units."""
        return self.change_mean + self.change_scale * change
