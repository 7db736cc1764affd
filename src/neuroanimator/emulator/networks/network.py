"""What every network is: a map from (odd, even) features to the normalised change of state.

`Gated` and `Classic` treat the two streams so that negating the odd one negates the answer, exactly
and at no cost: a mirrored motion is emulated by the mirrored numbers. `Mirrored` has answers of both kinds.
`Glu` and `LinearGlu` are for systems without a mirror.
"""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.errors import ArgumentError


class Network(eqx.Module):
    """A map (odd, even) → normalised change of state."""

    @property
    @abc.abstractmethod
    def widths(self) -> tuple[int, ...]:
        """Units in each hidden layer."""

    @abc.abstractmethod
    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        """Return the normalised change of state."""

    @abc.abstractmethod
    def leaves(self) -> dict[str, Any]:
        """Return every weight, or what stands for it, by the name that files give it: see docs/format.md."""


def prefixed(prefix: str, leaves: dict[str, Any]) -> dict[str, Any]:
    """Return `leaves` with `prefix` and a dot before their names."""
    return {f"{prefix}.{name}": tensor for name, tensor in leaves.items()}


def check_halves(widths: tuple[int, ...]) -> None:
    """Refuse odd widths of gated layers; ArgumentError says which."""
    if any(width % 2 for width in widths):
        raise ArgumentError(
            f"widths: gated layers are half odd, half even units; came {list(widths)}, want even."
        )


def random_weights(key: PRNGKeyArray, rows: int, columns: int) -> Float[Array, "{rows} {columns}"]:
    """Return normal weights that keep numbers of order one of order one."""
    return jax.random.normal(key, (rows, columns)) / jnp.sqrt(max(rows, 1))
