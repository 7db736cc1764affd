"""The origin of a motion: positions on which nothing depends are computed relative to it, and kept in more digits.

Positions are taken off a state in double precision, every super step begins near zero, and the ways add up in double
precision in NumPy and C, in two float32 numbers in JAX. So a motion far away is the same, and a long one keeps its digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.state.arrays import AnyArray

NOWHERE = -1
"""Axis of the entries that are no such positions."""

GRID = 1.5 * 2.0**12
"""Adding and then subtracting it rounds a double to a multiple of 2⁻⁴⁰ m, a picometre. Sums of such numbers are exact within
8 km, so that a motion moved there has the same bytes."""


@dataclass(frozen=True)
class Axes:
    """The A axes along which a vector may be moved."""

    of_entries: tuple[int, ...]
    """Axis of each entry that then changes; `NOWHERE` for others."""

    @cached_property
    def size(self) -> int:
        """Number of axes."""
        return max(self.of_entries, default=NOWHERE) + 1

    @cached_property
    def firsts(self) -> list[int]:
        """First entry along each axis."""
        return [self.of_entries.index(axis) for axis in range(self.size)]

    @cached_property
    def moved_entries(self) -> list[int]:
        """Entries that change."""
        return [entry for entry, axis in enumerate(self.of_entries) if axis != NOWHERE]

    def origin(self, vector: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B A"]:
        """Return the origin of `vector`: its first entry along each axis."""
        parts = [vector[..., first : first + 1] for first in self.firsts]
        return vector.__array_namespace__().concat([vector[..., :0], *parts], axis=-1)

    def moved(
        self, vector: Float[AnyArray, "*#B S"], way: Float[AnyArray, "*#B A"]
    ) -> Float[AnyArray, "*#B S"]:
        """Return `vector`, to whose entries the `way` along their axes is added."""
        xp = vector.__array_namespace__()
        with np.errstate(invalid="ignore"):  # of numbers that are not finite
            for axis in range(self.size):
                is_moved = xp.asarray(np.array(self.of_entries) == axis, dtype=vector.dtype)
                vector = vector + is_moved * way[..., axis : axis + 1]
        return vector


class Origin(NamedTuple):
    """The axes along which a system may be moved without any change of its motion."""

    state: Axes
    latent: Axes

    def together(
        self, origin: Float[np.ndarray, "*#B A"], relative: Float[np.ndarray, "*B S"]
    ) -> Float[np.ndarray, "*B S"]:
        """Return the states that are `relative` to `origin`, in double precision, on the grid of `GRID`."""
        exact = relative.astype(float)
        entries = self.state.moved_entries
        exact[..., entries] = on_grid(exact[..., entries])
        return self.state.moved(exact, origin)


class LocatedLatent(NamedTuple):
    """Latent states, and the origins that they are relative to."""

    latent: Float[np.ndarray, "*B I"]
    """In float32."""
    origin: Float[np.ndarray, "*B A"]
    """In double precision."""

    def moved_on(
        self, axes: Origin, following: Float[np.ndarray, "*B I"], states: Float[np.ndarray, "*B S"]
    ) -> tuple[LocatedLatent, Float[np.ndarray, "*B S"]]:
        """Return (the latent states `following` these with origins of their own, the `states` decoded from them in the world)."""
        way = axes.latent.origin(following)
        latent = axes.latent.moved(following, -way)
        origin = self.origin + on_grid(way.astype(float))
        return LocatedLatent(latent, origin), axes.together(self.origin, states)


def on_grid(way: Float[np.ndarray, " ..."]) -> Float[np.ndarray, " ..."]:
    """Return doubles rounded as `GRID` says."""
    return (way + GRID) - GRID


def two_sum(
    high: Float[Array, "*B A"], low: Float[Array, "*B A"], way: Float[Array, "*B A"]
) -> tuple[Float[Array, "*B A"], Float[Array, "*B A"]]:
    """Return `high` + `low` + `way` as a number and the remainder that its rounding left (Knuth's two-sum)."""
    way = way + jax.lax.stop_gradient(low)
    total = high + way
    of_way = total - high
    left = (high - (total - of_way)) + (way - of_way)
    return total, jax.lax.stop_gradient(left)
