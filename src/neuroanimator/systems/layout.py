"""Vectors with named slices and units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from neuroanimator.errors import ArgumentError


@dataclass(frozen=True)
class Slice:
    """`size` consecutive entries of a vector, all in `unit`."""

    name: str
    size: int
    unit: str


@dataclass(frozen=True)
class Layout:
    """The named parts of a vector, in order."""

    slices: tuple[Slice, ...]

    @property
    def size(self) -> int:
        """Length of the vector."""
        return sum(part.size for part in self.slices)

    @property
    def names(self) -> list[str]:
        """One name per entry: `velocity[2] rad/s`."""
        return [f"{part.name}[{i}] {part.unit}" for part in self.slices for i in range(part.size)]

    def index(self, name: str) -> slice:
        """Return where the part called `name` lies in the vector."""
        start = 0
        for part in self.slices:
            if part.name == name:
                return slice(start, start + part.size)
            start += part.size
        valid = ", ".join(part.name for part in self.slices)
        raise ArgumentError(f"No part called '{name}'. Parts: {valid}.")

    def check(self, vector: ArrayLike, label: str) -> np.ndarray:
        """Return `vector` as float64 if its last axis fits and every number is finite."""
        array = self.check_shape(vector, label)
        if not np.isfinite(array).all():
            entry = int(np.argwhere(~np.isfinite(array))[0][-1])
            raise ArgumentError(f"{label}: {self.names[entry]} is not finite. Give finite numbers only.")
        return array

    def check_shape(self, vector: ArrayLike, label: str) -> np.ndarray:
        """Return `vector` as float64 if its last axis fits."""
        array = np.asarray(vector, dtype=np.float64)
        if array.ndim == 0 or array.shape[-1] != self.size:
            raise ArgumentError(
                f"{label}: wanted {self.size} numbers ({', '.join(self.names)}), came shape {array.shape}."
            )
        return array

    def to_json(self) -> list[list]:
        """Return `[[name, size, unit], ...]`."""
        return [[part.name, part.size, part.unit] for part in self.slices]

    @classmethod
    def from_json(cls, rows: list[list]) -> Layout:
        """Return the layout `to_json` wrote."""
        return cls(tuple(Slice(str(name), int(size), str(unit)) for name, size, unit in rows))


@dataclass(frozen=True)
class Bounds:
    """The least and the largest value of each entry of a control, in its own unit."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def symmetric(cls, limit: ArrayLike) -> Bounds:
        """Return the bounds ±`limit` (C,)."""
        numbers = tuple(float(value) for value in np.asarray(limit))
        return cls(tuple(-value for value in numbers), numbers)

    @property
    def middle(self) -> np.ndarray:
        """(C,) halfway between the bounds."""
        return (np.array(self.high) + np.array(self.low)) / 2

    @property
    def half(self) -> np.ndarray:
        """(C,) half the way from bound to bound."""
        return (np.array(self.high) - np.array(self.low)) / 2

    @property
    def largest(self) -> np.ndarray:
        """(C,) largest magnitude: what counts as full effort."""
        return np.maximum(np.abs(self.high), np.abs(self.low))

    @property
    def idle(self) -> np.ndarray:
        """(C,) no control at all, or as little as the bounds allow."""
        return self.clip(np.zeros(len(self.low)))

    def contain(self, controls: np.ndarray) -> bool:
        """Return whether all `controls` (..., C) lie within the bounds, to within rounding."""
        return not self._beyond(controls).any()

    def _beyond(self, controls: np.ndarray) -> np.ndarray:
        slack = 1e-6 * self.largest
        return (controls < np.array(self.low) - slack) | (controls > np.array(self.high) + slack)

    def clip(self, controls: np.ndarray) -> np.ndarray:
        """Return `controls` (..., C) with every entry brought within the bounds."""
        return np.clip(controls, self.low, self.high)

    def check(self, controls: np.ndarray, names: list[str]) -> np.ndarray:
        """Return `controls` (..., C); ArgumentError names an entry that is out of bounds."""
        beyond = self._beyond(controls)
        if beyond.any():
            place = tuple(np.argwhere(beyond)[0])
            entry = place[-1]
            raise ArgumentError(
                f"control: {names[entry]} out of bounds; wanted between {self.low[entry]:g} and {self.high[entry]:g}, "
                f"came {controls[place]:g}."
            )
        return controls
