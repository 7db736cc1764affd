"""Layers of gated units for systems whose motion is odd: negating everything negates the motion."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.networks.network import (
    Network,
    Units,
    check_halves,
    prefixed,
    random_weights,
    split_key,
)
from neuroanimator.state.arrays import AnyArray


class GatedLayer(eqx.Module):
    """Products of a saturating and a linear part.

    tanh(odd) · linear(even) is odd again; tanh(odd) · linear(odd) and tanh(even) are even. Torque
    times inverse inertia and speed times speed, which mechanics is made of, are such products.
    """

    odd_in: Float[AnyArray, "O H3"]
    """Side by side, because one product is faster than three: tanh of the odd units, tanh and factor of pairs."""
    even_in: Float[AnyArray, "E H2"]
    """Side by side: factor of the odd units, tanh of the even units."""
    bias: Float[AnyArray, " H2"]

    @classmethod
    def of(cls, odd: int, even: int, half: int, *, key: PRNGKeyArray | None) -> GatedLayer:
        """Return a fresh layer with `half` odd and as many even units; without a key its weights are zeros."""
        keys = split_key(key, 2)
        return cls(
            odd_in=random_weights(keys[0], odd, 3 * half),
            even_in=random_weights(keys[1], even, 2 * half),
            bias=np.repeat(np.array([1, 0], np.float32), half),
        )

    def __call__(
        self, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> tuple[Float[Array, " H"], Float[Array, " H"]]:
        odd_units, pair, factor = jnp.split(odd @ self.odd_in, 3)
        gate, level = jnp.split(even @ self.even_in + self.bias, 2)
        return jnp.tanh(odd_units) * gate, jnp.tanh(pair) * factor + jnp.tanh(level)

    def leaves(self) -> dict[str, Any]:
        """Return every weight, or what stands for it, by the name that files give it."""
        return {"odd_weight": self.odd_in, "even_weight": self.even_in, "bias": self.bias}


class Gated(Network):
    """Layers of gated units, then a linear map. The default."""

    layers: tuple[GatedLayer, ...]
    out: Float[AnyArray, "H S"]

    @classmethod
    def of(
        cls, odd: int, even: int, out: int, widths: tuple[int, ...], *, key: PRNGKeyArray | None
    ) -> Gated:
        """Return a fresh network; without a key its weights are zeros."""
        check_halves(widths)
        keys = split_key(key, len(widths) + 1)
        layers = []
        for width, layer_key in zip(widths, keys[1:], strict=True):
            layers.append(GatedLayer.of(odd, even, width // 2, key=layer_key))
            odd = even = width // 2
        return cls(tuple(layers), random_weights(keys[0], odd, out, scale=0.1))

    def leaves(self) -> dict[str, Any]:
        return {**layer_leaves(self.layers), "out.weight": self.out}

    @property
    def widths(self) -> tuple[int, ...]:
        return tuple(layer.bias.shape[0] for layer in self.layers)

    @property
    def unit_counts(self) -> tuple[int, int]:
        return self.widths[-1] // 2, 0

    def units(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Units:
        for layer in self.layers:
            odd, even = layer(odd, even)
        return Units(odd, even[:0])  # every answer is odd

    def answers(
        self, units: Units, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> Float[Array, " S"]:
        return units.odd @ self.out


def layer_leaves(layers: tuple[GatedLayer, ...]) -> dict[str, Any]:
    """Return the weights of `layers` as `layer0.bias` and so on."""
    tensors = {}
    for number, layer in enumerate(layers):
        tensors.update(prefixed(f"layer{number}", layer.leaves()))
    return tensors
