"""Distance of an input from an emulator's training: 1 is the edge."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.emulator.arrays import zeros
from neuroanimator.emulator.networks import layer_width
from neuroanimator.emulator.networks.network import Network, Units
from neuroanimator.files.numbers import listed
from neuroanimator.state.arrays import AnyArray

EDGE = 1.0
"""Maximum score that counts as within training."""


class TrustMeter(eqx.Module):
    """Distance of the last layer's units from their mean in training, along the directions in which errors grow.

    Answers are linear in these units, so an ensemble of last layers, all equally likely given the data, disagrees
    by their Mahalanobis distance: this is that ensemble at the cost of a small matrix. `docs/decisions/0022-trust.md`
    tells how it was chosen.
    """

    odd: Float[AnyArray, "H P"]
    """Directions of the units that change sign in the mirror: their mean is zero, and a mirror image scores the same."""
    even: Float[AnyArray, "G Q"]
    even_mean: Float[AnyArray, " G"]

    def to_json(self) -> list[int]:
        """Return the numbers of odd and of even directions."""
        return [self.odd.shape[1], self.even.shape[1]]

    @classmethod
    def blank(cls, described: Any, network: Network) -> TrustMeter:
        """Return a blank meter of the units of `network` with the numbers of directions that `to_json` wrote."""
        odd, even = listed(described, "trust", layer_width, 2)
        if odd + even == 0:
            raise ValueError("trust: wanted a direction or more")
        odd_units, even_units = network.unit_counts
        return cls(zeros(odd_units, odd), zeros(even_units, even), zeros(even_units))

    def squared(self, units: Units) -> Float[Array, ""]:
        """Return the square of the score of `units`."""
        parts = []
        if self.odd.shape[1]:
            parts.append(units.odd @ self.odd)
        if self.even.shape[1]:
            parts.append((units.even - self.even_mean) @ self.even)
        distances = jnp.concatenate(parts)
        return jnp.sum(distances * distances)
