"""The network of 1998: one hidden layer of logistic units."""

from __future__ import annotations

from typing import Any

import jax
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.arrays import zeros
from neuroanimator.emulator.networks.network import (
    Network,
    NetworkShape,
    Units,
    random_weights,
    split_key,
)
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray


class Classic(Network):
    """One hidden layer of logistic units with biases, as in 1998.

    σ(e + o) - σ(e - o) is odd in o; it is the network of 1998 minus its mirror image.
    """

    usual_widths = (40,)

    odd_in: Float[AnyArray, "O H"]
    even_in: Float[AnyArray, "E H"]
    bias: Float[AnyArray, " H"]
    out: Float[AnyArray, "H S"]

    @classmethod
    def of(cls, shape: NetworkShape, *, key: PRNGKeyArray | None) -> Classic:
        widths = shape.widths
        if len(widths) != 1:
            raise ArgumentError(
                f"widths: the classic network has one hidden layer, got {list(widths)}."
            )
        keys = split_key(key, 3)
        return cls(
            odd_in=random_weights(keys[0], shape.odd, widths[0]),
            even_in=random_weights(keys[1], shape.even, widths[0]),
            bias=zeros(widths[0]),
            out=random_weights(keys[2], widths[0], shape.out),
        )

    def leaves(self) -> dict[str, Any]:
        return {
            "layer0.odd_weight": self.odd_in,
            "layer0.even_weight": self.even_in,
            "layer0.bias": self.bias,
            "out.weight": self.out,
        }

    @property
    def widths(self) -> tuple[int, ...]:
        return (self.bias.shape[0],)

    @property
    def unit_counts(self) -> tuple[int, int]:
        count = self.bias.shape[0]
        return (count, 0) if self.even_in.shape[0] else (0, count)

    def units(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Units:
        pushed = odd @ self.odd_in
        if not even.shape[0]:  # no mirror: the network of 1998 itself
            return Units(even, jax.nn.sigmoid(pushed + self.bias))
        level = even @ self.even_in + self.bias
        return Units(jax.nn.sigmoid(level + pushed) - jax.nn.sigmoid(level - pushed), even[:0])

    def answers(
        self, units: Units, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> Float[Array, " S"]:
        return (units.odd if even.shape[0] else units.even) @ self.out
