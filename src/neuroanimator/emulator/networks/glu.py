"""Gated linear units, for systems without a mirror."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.arrays import zeros
from neuroanimator.emulator.networks.network import (
    Network,
    NetworkShape,
    Units,
    random_weights,
    split_key,
)
from neuroanimator.state.arrays import AnyArray


class Glu(Network):
    """Layers tanh(W x + a) · (V x + b), then a linear map: gated units without mirror symmetry."""

    layers: tuple[Float[AnyArray, "I H2"], ...]
    """Concatenated: saturating part, linear part."""
    biases: tuple[Float[AnyArray, " H2"], ...]
    out: Float[AnyArray, "H S"]

    @classmethod
    def of(cls, shape: NetworkShape, *, key: PRNGKeyArray | None) -> Glu:
        keys = split_key(key, len(shape.widths) + 1)
        sizes = [shape.odd + shape.even, *shape.widths]
        layers = []
        biases = []
        for layer_key, rows, width in zip(keys[1:], sizes, shape.widths, strict=False):
            layers.append(random_weights(layer_key, rows, 2 * width))
            biases.append(np.repeat(np.array([0, 1], np.float32), width))
        return cls(
            tuple(layers), tuple(biases), random_weights(keys[0], sizes[-1], shape.out, scale=0.1)
        )

    def leaves(self) -> dict[str, Any]:
        tensors = {}
        for number, (layer, bias) in enumerate(zip(self.layers, self.biases, strict=True)):
            tensors[f"layer{number}.weight"] = layer
            tensors[f"layer{number}.bias"] = bias
        return {**tensors, "out.weight": self.out}

    @property
    def widths(self) -> tuple[int, ...]:
        return tuple(bias.shape[0] // 2 for bias in self.biases)

    @property
    def unit_counts(self) -> tuple[int, int]:
        return 0, self.widths[-1]

    def units(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Units:
        units = jnp.concatenate([odd, even]) if even.shape[0] else odd
        for layer, bias in zip(self.layers, self.biases, strict=True):
            saturating, linear = jnp.split(units @ layer + bias, 2)
            units = jnp.tanh(saturating) * linear
        return Units(odd[:0], units)

    def answers(
        self, units: Units, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> Float[Array, " S"]:
        return units.even @ self.out


class LinearGlu(Network):
    """A linear map, as in `Mirrored`, plus the layers of `Glu`: nearly linear behaviour needs no units."""

    glu: Glu
    linear: Float[AnyArray, "I S"]

    @classmethod
    def of(cls, shape: NetworkShape, *, key: PRNGKeyArray | None) -> LinearGlu:
        """Return a fresh network with a zero linear map; without a key all weights are zeros."""
        return cls(Glu.of(shape, key=key), zeros(shape.odd + shape.even, shape.out))

    def leaves(self) -> dict[str, Any]:
        return {**self.glu.leaves(), "linear.weight": self.linear}

    @property
    def widths(self) -> tuple[int, ...]:
        return self.glu.widths

    @property
    def unit_counts(self) -> tuple[int, int]:
        return self.glu.unit_counts

    def units(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Units:
        return self.glu.units(odd, even)

    def answers(
        self, units: Units, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> Float[Array, " S"]:
        features = jnp.concatenate([odd, even]) if even.shape[0] else odd
        return self.glu.answers(units, odd, even) + features @ self.linear
