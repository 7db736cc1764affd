"""Gated linear units, for systems without a mirror."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.networks.network import Network, random_weights


class Glu(Network):
    """Layers tanh(W x + a) · (V x + b), then a linear map: gated units where there is no mirror to respect."""

    layers: tuple[Float[Array, "I H2"], ...]
    """Side by side: saturating part, linear part."""
    biases: tuple[Float[Array, " H2"], ...]
    out: Float[Array, "H S"]

    def __init__(
        self, odd: int, even: int, out: int, widths: tuple[int, ...], *, key: PRNGKeyArray
    ):
        keys = jax.random.split(key, len(widths) + 1)
        sizes = [odd + even, *widths]
        self.layers = tuple(
            random_weights(k, rows, 2 * width)
            for k, rows, width in zip(keys[1:], sizes, widths, strict=False)
        )
        self.biases = tuple(
            jnp.concatenate([jnp.zeros(width), jnp.ones(width)]) for width in widths
        )
        self.out = 0.1 * random_weights(keys[0], sizes[-1], out)

    def leaves(self) -> dict[str, Any]:
        tensors = {}
        for number, (layer, bias) in enumerate(zip(self.layers, self.biases, strict=True)):
            tensors[f"layer{number}.weight"] = layer
            tensors[f"layer{number}.bias"] = bias
        return {**tensors, "out.weight": self.out}

    @property
    def widths(self) -> tuple[int, ...]:
        return tuple(bias.shape[0] // 2 for bias in self.biases)

    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        units = jnp.concatenate([odd, even]) if even.shape[0] else odd
        for layer, bias in zip(self.layers, self.biases, strict=True):
            saturating, linear = jnp.split(units @ layer + bias, 2)
            units = jnp.tanh(saturating) * linear
        return units @ self.out


class LinearGlu(Network):
    """A linear map plus the layers of `Glu`, as `Mirrored` has one: what is nearly linear needs no units."""

    glu: Glu
    linear: Float[Array, "I S"]

    def __init__(
        self, odd: int, even: int, out: int, widths: tuple[int, ...], *, key: PRNGKeyArray
    ):
        self.glu = Glu(odd, even, out, widths, key=key)
        self.linear = jnp.zeros((odd + even, out))

    def leaves(self) -> dict[str, Any]:
        return {**self.glu.leaves(), "linear.weight": self.linear}

    @property
    def widths(self) -> tuple[int, ...]:
        return self.glu.widths

    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        features = jnp.concatenate([odd, even]) if even.shape[0] else odd
        return self.glu(odd, even) + features @ self.linear
