"""A network for bodies with a left and a right: some answers are odd in the mirror, others even."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.arrays import zeros
from neuroanimator.emulator.features import reordered
from neuroanimator.emulator.networks.gated import GatedNetwork, gated_layers, layer_leaves
from neuroanimator.emulator.networks.network import (
    NetworkShape,
    Units,
    random_weights,
    split_key,
)
from neuroanimator.state.arrays import AnyArray


class Mirrored(GatedNetwork):
    """A linear map plus layers of gated units as in `Gated`, for bodies with a left and a right.

    Springs are nearly linear: the linear map alone leaves an eighth of the change unexplained. In the mirror, odd
    answers change sign and even ones do not, exactly: what is learnt about a left turn holds for a right turn.
    At equal width it costs half of `Glu`.
    """

    odd_out: Float[AnyArray, "H O"]
    even_out: Float[AnyArray, "H E"]
    odd_linear: Float[AnyArray, "I O"]
    even_linear: Float[AnyArray, "J E"]
    even: tuple[int, ...] = eqx.field(static=True)
    """Answers that are even."""

    @classmethod
    def of(cls, shape: NetworkShape, *, key: PRNGKeyArray | None) -> Mirrored:
        """Return a fresh network with a zero linear map; without a key all weights are zeros."""
        keys = split_key(key, len(shape.widths) + 2)
        even_answers = len(shape.even_out)
        odd_answers = shape.out - even_answers
        layers = gated_layers(shape, keys[2:])
        odd = layers[-1].half if layers else shape.odd
        even = layers[-1].half if layers else shape.even
        return cls(
            layers=layers,
            odd_out=random_weights(keys[0], odd, odd_answers, scale=0.1),
            even_out=random_weights(keys[1], even, even_answers, scale=0.1),
            odd_linear=zeros(shape.odd, odd_answers),
            even_linear=zeros(shape.even, even_answers),
            even=tuple(shape.even_out),
        )

    def leaves(self) -> dict[str, Any]:
        return {
            **layer_leaves(self.layers),
            "out.odd_weight": self.odd_out,
            "out.even_weight": self.even_out,
            "linear.odd_weight": self.odd_linear,
            "linear.even_weight": self.even_linear,
        }

    @property
    def unit_counts(self) -> tuple[int, int]:
        return self.widths[-1] // 2, self.widths[-1] // 2

    def units(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Units:
        return Units(*self.gated_units(odd, even))

    def answers(
        self, units: Units, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> Float[Array, " S"]:
        odd_answers = odd @ self.odd_linear + units.odd @ self.odd_out
        even_answers = even @ self.even_linear + units.even @ self.even_out
        answers = jnp.concatenate([odd_answers, even_answers])
        return reordered(answers, self._order())

    def _order(self) -> tuple[int, ...]:
        """Return the index of each answer in (odd answers, even answers)."""
        first_even = self.odd_out.shape[1]
        slots = {answer: first_even + i for i, answer in enumerate(self.even)}
        size = first_even + len(self.even)
        odd = [answer for answer in range(size) if answer not in slots]
        slots.update({answer: i for i, answer in enumerate(odd)})
        return tuple(slots[answer] for answer in range(size))
