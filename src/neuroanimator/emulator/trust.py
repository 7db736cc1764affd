"""How far an input lies from what an emulator was trained on: 1 is the edge."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.emulator.networks.network import Units
from neuroanimator.state.arrays import AnyArray

EDGE = 1.0
"""Scores up to this are those of training."""


class TrustMeter(eqx.Module):
    """Distance of the last layer's units from their mean in training, along the directions in which errors grow.

    Answers are linear in these units, so that an ensemble of last layers, each as likely as the others by the data,
    disagrees by their Mahalanobis distance: it is that ensemble at the cost of a small matrix. How it was
    chosen is in `docs/decisions/0022-trust.md`.
    """

    odd: Float[AnyArray, "H P"]
    """Directions of the units that change sign in the mirror: their mean is zero, and the score the mirror image's."""
    even: Float[AnyArray, "G Q"]
    even_mean: Float[AnyArray, " G"]

    def squared(self, units: Units) -> Float[Array, ""]:
        """Return the square of the score of `units`."""
        parts = []
        if self.odd.shape[1]:
            parts.append(units.odd @ self.odd)
        if self.even.shape[1]:
            parts.append((units.even - self.even_mean) @ self.even)
        distances = jnp.concatenate(parts)
        return jnp.sum(distances * distances)
