"""Layers of gated units for systems whose motion is odd: negating everything negates the motion."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.networks.network import (
    Network,
    NetworkShape,
    Units,
    prefixed,
    random_weights,
    split_key,
)
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray


class GatedLayer(eqx.Module):
    """Products of a saturating and a linear part.

    tanh(odd) · linear(even) is odd again; tanh(odd) · linear(odd) and tanh(even) are even. Products of
    mechanics, such as torque times inverse inertia and speed times speed, have this form. Parameters of a
    family are even and scale even quantities, too: there the last ones are tanh(even) · linear(even).
    """

    odd_in: Float[AnyArray, "O H3"]
    """Concatenated, because one product is faster than three: tanh of the odd units, tanh and factor of pairs."""
    even_in: Float[AnyArray, "E K"]
    """Concatenated: factor of the odd units, tanh of the even units, and if these are gated their factor."""
    bias: Float[AnyArray, " K"]

    @classmethod
    def of(
        cls, odd: int, even: int, half: int, *, key: PRNGKeyArray | None, gates_even: bool = False
    ) -> GatedLayer:
        """Return a fresh layer with `half` odd and as many even units; without a key its weights are zeros."""
        keys = split_key(key, 2)
        biases = [1, 0, 1] if gates_even else [1, 0]
        return cls(
            odd_in=random_weights(keys[0], odd, 3 * half),
            even_in=random_weights(keys[1], even, len(biases) * half),
            bias=np.repeat(np.array(biases, np.float32), half),
        )

    @property
    def half(self) -> int:
        """Number of odd units, which is also that of even ones."""
        return self.odd_in.shape[1] // 3

    @property
    def gates_even(self) -> bool:
        """Whether tanh(even) has a factor."""
        return self.bias.shape[0] == 3 * self.half

    def __call__(
        self, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> tuple[Float[Array, " H"], Float[Array, " H"]]:
        odd_units, pair, factor = jnp.split(odd @ self.odd_in, 3)
        from_even = even @ self.even_in + self.bias
        if not self.gates_even:
            gate, level = jnp.split(from_even, 2)
            return jnp.tanh(odd_units) * gate, jnp.tanh(pair) * factor + jnp.tanh(level)
        gate, level, level_gate = jnp.split(from_even, 3)
        even_units = jnp.tanh(pair) * factor + jnp.tanh(level) * level_gate
        return jnp.tanh(odd_units) * gate, even_units

    def odd_units(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " H"]:
        """Return the odd units alone, by a third of the products."""
        half = self.half
        gate = even @ self.even_in[:, :half] + self.bias[:half]
        return jnp.tanh(odd @ self.odd_in[:, :half]) * gate

    def leaves(self) -> dict[str, Any]:
        """Return every weight, or its placeholder, by its name in files."""
        return {"odd_weight": self.odd_in, "even_weight": self.even_in, "bias": self.bias}


class GatedNetwork(Network):
    """A network of layers of gated units."""

    layers: tuple[GatedLayer, ...]

    @property
    def widths(self) -> tuple[int, ...]:
        return tuple(2 * layer.half for layer in self.layers)

    @property
    def gates_even(self) -> bool:
        """Whether even units are gated by even features: see `GatedLayer`."""
        return any(layer.gates_even for layer in self.layers)

    def gated_units(
        self, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> tuple[Float[Array, " H"], Float[Array, " H"]]:
        """Return the odd and the even units of the last layer; the streams themselves without layers."""
        for layer in self.layers:
            odd, even = layer(odd, even)
        return odd, even


class Gated(GatedNetwork):
    """Layers of gated units, then a linear map. The default."""

    out: Float[AnyArray, "H S"]

    @classmethod
    def of(cls, shape: NetworkShape, *, key: PRNGKeyArray | None) -> Gated:
        keys = split_key(key, len(shape.widths) + 1)
        layers = gated_layers(shape, keys[1:])
        units = layers[-1].half if layers else shape.odd
        return cls(layers, random_weights(keys[0], units, shape.out, scale=0.1))

    def leaves(self) -> dict[str, Any]:
        return {**layer_leaves(self.layers), "out.weight": self.out}

    @property
    def unit_counts(self) -> tuple[int, int]:
        return self.widths[-1] // 2, 0

    def units(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Units:
        no_units = even[:0]  # every answer is odd
        for layer in self.layers[:-1]:
            odd, even = layer(odd, even)
        if self.layers:
            odd = self.layers[-1].odd_units(odd, even)
        return Units(odd, no_units)

    def answers(
        self, units: Units, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> Float[Array, " S"]:
        return units.odd @ self.out


def gated_layers(shape: NetworkShape, keys: Any) -> tuple[GatedLayer, ...]:
    """Return fresh layers, one after another, for the streams of `shape`; ArgumentError for odd widths."""
    if any(width % 2 for width in shape.widths):
        raise ArgumentError(
            "widths: wanted even numbers, since gated layers are half odd, half even units; got "
            f"{list(shape.widths)}."
        )
    odd = shape.odd
    even = shape.even
    layers = []
    for width, key in zip(shape.widths, keys, strict=True):
        layers.append(GatedLayer.of(odd, even, width // 2, key=key, gates_even=shape.gates_even))
        odd = even = width // 2
    return tuple(layers)


def layer_leaves(layers: tuple[GatedLayer, ...]) -> dict[str, Any]:
    """Return the weights of `layers` as `layer0.bias` and so on."""
    tensors = {}
    for number, layer in enumerate(layers):
        tensors.update(prefixed(f"layer{number}", layer.leaves()))
    return tensors
