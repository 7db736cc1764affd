"""The interface of networks: maps from (odd, even) features to the normalised change of state.

`Gated` and `Classic` treat the two streams so that negating the odd one negates the answer, exactly
and at no cost: a mirrored motion is emulated by the mirrored numbers. `Mirrored` has answers of both kinds.
`Glu` and `LinearGlu` are for systems without a mirror.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.arrays import as_jax, zeros
from neuroanimator.state.arrays import AnyArray

Entries = tuple[int, ...]


@dataclass(frozen=True)
class Part:
    """Inputs and answers of one network of the hierarchy."""

    name: str
    odd: Entries
    """Entries of the odd stream it sees."""
    even: Entries
    """Entries of the even stream it sees."""
    answers: Entries
    """Numbers of the change it predicts."""
    hears: Entries = ()
    """Answers of the upper network that it sees too, as numbers of the change; empty for the upper network."""
    like: int = -1
    """Number of the earlier child whose weights it uses; -1 for its own."""


class NetworkShape(NamedTuple):
    """Inputs, hidden layers and answers of a network."""

    odd: int
    """Size of the odd stream."""
    even: int
    out: int
    """Number of answers."""
    widths: tuple[int, ...]
    """Number of units in each hidden layer."""
    even_out: Entries = ()
    """Answers that are unchanged in the mirror; for `mirrored` and `hierarchy` only."""
    parts: tuple[Part, ...] = ()
    """Inputs and answers of each part; for `hierarchy` only."""
    gates_even: bool = False
    """See `GatedLayer`; for `gated` and `mirrored` only."""


class Units(NamedTuple):
    """Units of the last hidden layer."""

    odd: Float[Array, " H"]
    """Units that change sign in the mirror; none without a mirror."""
    even: Float[Array, " G"]


class Network(eqx.Module):
    """A map (odd, even) → normalised change of state."""

    usual_widths: ClassVar[tuple[int, ...]] = (96, 64)
    """Default `widths`."""

    @classmethod
    @abc.abstractmethod
    def of(cls, shape: NetworkShape, *, key: PRNGKeyArray | None) -> Self:
        """Return a fresh network; without a key its weights are zeros."""

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
