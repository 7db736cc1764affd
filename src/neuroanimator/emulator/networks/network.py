"""The interface of networks: maps from (odd, even) features to the normalised change of state.

`Gated` and `Classic` treat the two streams so that negating the odd one negates the answer, exactly
and at no cost: a mirrored motion is emulated by the mirrored numbers. `Mirrored` has answers of both kinds.
`Glu` and `LinearGlu` are for systems without a mirror.
"""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.arrays import as_jax, zeros
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray


class Units(NamedTuple):
    """Units of the last hidden layer."""

    odd: Float[Array, " H"]
    """Units that change sign in the mirror; none without a mirror."""
    even: Float[Array, " G"]


class Network(eqx.Module):
    """A map (odd, even) → normalised change of state."""

    @property
    @abc.abstractmethod
    def widths(self) -> tuple[int, ...]:
        """Number of units in each hidden layer."""

    @property
    @abc.abstractmethod
    def unit_counts(self) -> tuple[int, int]:
        """Number of odd and of even `units`."""

    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        """Return the normalised change of state."""
        return self.answers(self.units(odd, even), odd, even)

    @abc.abstractmethod
    def units(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Units:
        """Return the units of the last hidden layer that any answer needs."""

    @abc.abstractmethod
    def answers(
        self, units: Units, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> Float[Array, " S"]:
        """Return the normalised change of state from the `units` of both streams, in which it is linear."""

    @abc.abstractmethod
    def leaves(self) -> dict[str, Any]:
        """Return every weight, or its placeholder, by its name in files: see docs/format.md."""


def prefixed(prefix: str, leaves: dict[str, Any]) -> dict[str, Any]:
    """Return `leaves` with `prefix` and a dot before their names."""
    return {f"{prefix}.{name}": tensor for name, tensor in leaves.items()}


def check_halves(widths: tuple[int, ...]) -> None:
    """Refuse odd widths of gated layers; ArgumentError names them."""
    if any(width % 2 for width in widths):
        raise ArgumentError(
            f"widths: wanted even numbers, since gated layers are half odd, half even units; got {list(widths)}."
        )


def split_key(key: PRNGKeyArray | None, count: int) -> Any:
    """Return `count` keys, or None `count` times without a key: weights are then zeros, for a file to fill."""
    return [None] * count if key is None else jax.random.split(key, count)


def random_weights(
    key: PRNGKeyArray | None, rows: int, columns: int, scale: float = 1.0
) -> Float[AnyArray, "{rows} {columns}"]:
    """Return normal weights that map numbers of order one to the order of `scale`; zeros without a key."""
    if key is None:
        return zeros(rows, columns)
    normal = np.asarray(jax.random.normal(key, (rows, columns)))
    # In NumPy, as JAX would compile a program for every shape; bit for bit as JAX, which multiplies by the reciprocal.
    one = normal.dtype.type(1)
    return as_jax(scale * (normal * (one / np.sqrt(one * max(rows, 1)))), normal.dtype)
