"""Vectors with named slices and units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Num
from numpy.typing import ArrayLike

from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known, check_label, refuse_twins
from neuroanimator.files.numbers import numbers, whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.units import STATE_UNITS
from neuroanimator.text import quoted

MAX_NUMBERS = 4096
"""Maximum length of a vector read from a file: memory and time grow with it."""

REAL_KINDS = "biuf"
"""NumPy's kinds of truth values, integers and real numbers."""

BFLOAT16 = "bfloat16"
"""Name of JAX's bfloat16, which NumPy does not count as real."""

Pairs = tuple[tuple[int, int], ...]
"""Pairs (i, j) of entries of a vector, such as those of a number and of its time derivative."""


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

    @cached_property
    def size(self) -> int:
        """Length of the vector."""
        return sum(part.size for part in self.slices)

    @property
    def names(self) -> list[str]:
        """One name per entry: `velocity[2] rad/s`."""
        return [f"{part.name}[{i}] {part.unit}" for part in self.slices for i in range(part.size)]

    def index(self, name: str) -> slice:
        """Return the slice of the part called `name`."""
        names = [part.name for part in self.slices]
        check_known([name], names, "part")
        number = names.index(name)
        start = sum(part.size for part in self.slices[:number])
        return slice(start, start + self.slices[number].size)

    def part(self, vector: Num[AnyArray, "*B S"], name: str) -> Num[AnyArray, "*B P"]:
        """Return the part called `name` of `vector` (..., S)."""
        return vector[..., self.index(name)]

    def check(self, vector: ArrayLike, label: str) -> np.ndarray:
        """Return `vector` as float64 if its last axis fits and every number is finite.

        Raises ArgumentError, also for texts, complex numbers, objects and rows of unequal length.
        """
        array = self.check_shape(vector, label)
        if not np.isfinite(array).all():
            first = np.argwhere(~np.isfinite(array))[0]
            entry = int(first[-1])
            raise ArgumentError(
                f"{label}: {self.names[entry]} is not finite. Give finite numbers only."
            )
        return array

    def check_shape(self, vector: ArrayLike, label: str) -> np.ndarray:
        """Return `vector` as float64 if its last axis fits."""
        array = as_numbers(vector, label)
        if array.ndim == 0 or array.shape[-1] != self.size:
            raise ArgumentError(
                f"{label}: wanted {self.size} numbers ({', '.join(self.names)}), got shape {array.shape}."
            )
        return array

    def to_json(self) -> list[list]:
        """Return `[[name, size, unit], ...]`."""
        return [[part.name, part.size, part.unit] for part in self.slices]

    @classmethod
    def from_json(cls, rows: Any, what: str, least: int = 1) -> Layout:
        """Return the layout of a state or control, `what`, that `to_json` wrote, of `least` parts or more.

        Raises ValueError for names, units and sizes no system has.
        """
        if not isinstance(rows, list) or not least <= len(rows) <= MAX_NUMBERS:
            raise ValueError(f"{what}: wanted {least} to {MAX_NUMBERS} named parts")
        layout = cls(tuple(_slice_from_json(row, what) for row in rows))
        refuse_twins((part.name for part in layout.slices), what)
        whole(layout.size, f"{what}: numbers in all", least, MAX_NUMBERS)
        return layout


def _slice_from_json(row: Any, what: str) -> Slice:
    if not isinstance(row, list) or len(row) != 3:
        raise ValueError(f"{what}: wanted name, size and unit of every part, got {quoted(row)}")
    name, number, unit = row
    check_label(name, what)
    if not isinstance(unit, str) or unit not in STATE_UNITS:
        raise ValueError(f"{what}: '{name}' has the unknown unit {quoted(unit)}")
    size = whole(number, f"{what}: size of '{name}'", 1, MAX_NUMBERS)
    return Slice(name, size, unit)


def as_numbers(values: ArrayLike, label: str) -> np.ndarray:
    """Return `values` as float64, in their own shape; ArgumentError if they are not real numbers."""
    try:
        array = np.asarray(values)
    except (ValueError, OverflowError) as error:
        raise ArgumentError(
            f"{label}: wanted numbers in rows equally long, got {_what(values)}."
        ) from error
    if array.dtype.kind not in REAL_KINDS and array.dtype.name != BFLOAT16:
        raise ArgumentError(
            f"{label}: wanted real numbers, got {_what(values)} of {array.dtype.name[:40]}."
        )
    with np.errstate(over="ignore"):  # too large long doubles become infinite
        return array.astype(np.float64, copy=False)


def _what(values: object) -> str:
    return f"a {type(values).__name__}"


@dataclass(frozen=True)
class Bounds:
    """The smallest and the largest value of each entry of a control, in its own unit."""

    low: tuple[float, ...]
    high: tuple[float, ...]
    holding: tuple[float, ...] = ()
    """The control that holds the system at rest, such as a drone's hover; empty for none."""

    @classmethod
    def symmetric(cls, limit: ArrayLike) -> Bounds:
        """Return the bounds ±`limit` (C,)."""
        numbers = tuple(float(value) for value in np.asarray(limit))
        return cls(tuple(-value for value in numbers), numbers)

    @classmethod
    def from_json(cls, sides: Any, size: int, what: str) -> Bounds:
        """Return the bounds `to_json` wrote, of `size` numbers; ValueError names what is wrong."""
        if not isinstance(sides, list) or len(sides) not in (2, 3):
            raise ValueError(f"{what}: wanted the least and the largest values")
        low = numbers(sides[0], what, size)
        high = numbers(sides[1], what, size)
        for least, largest in zip(low, high, strict=True):
            if least > largest:
                raise ValueError(
                    f"{what}: wanted the least value below the largest, got {least:g} and {largest:g}"
                )
        if len(sides) == 2:
            return cls(low, high)
        return cls(low, high, numbers(sides[2], what, size))

    def to_json(self) -> list[list[float]]:
        """Return the smallest values, the largest, and those that hold the system unless they are zero."""
        sides = [list(self.low), list(self.high)]
        if self.holding:
            sides.append(list(self.holding))
        return sides

    @property
    def middle(self) -> np.ndarray:
        """Middle between the bounds (C,)."""
        return (np.array(self.high) + np.array(self.low)) / 2

    @property
    def half(self) -> np.ndarray:
        """Half the distance between the bounds (C,)."""
        return (np.array(self.high) - np.array(self.low)) / 2

    @property
    def magnitude(self) -> np.ndarray:
        """Largest magnitude (C,), which counts as full effort."""
        return np.maximum(np.abs(self.high), np.abs(self.low))

    @property
    def idle(self) -> np.ndarray:
        """Control that holds the system at rest (C,): `holding` if given, else zero, or as near to it as the bounds allow."""
        return self.clip(np.array(self.holding or np.zeros(len(self.low))))

    @property
    def reach(self) -> np.ndarray:
        """Distance from the idle control to the farther bound (C,): half the range if it is in the middle."""
        return np.maximum(np.array(self.high) - self.idle, self.idle - np.array(self.low))

    def contain(self, controls: np.ndarray) -> bool:
        """Return whether all `controls` (..., C) lie within the bounds, up to rounding."""
        return not self._beyond(controls).any()

    def _beyond(self, controls: np.ndarray) -> np.ndarray:
        slack = 1e-6 * self.magnitude
        is_low = controls < np.array(self.low) - slack
        is_high = controls > np.array(self.high) + slack
        return is_low | is_high

    def clip(self, controls: np.ndarray) -> np.ndarray:
        """Return `controls` (..., C) clipped to the bounds."""
        return np.clip(controls, self.low, self.high)

    def check(self, controls: np.ndarray, names: list[str]) -> np.ndarray:
        """Return `controls` (..., C); ArgumentError names an entry that is out of bounds."""
        beyond = self._beyond(controls)
        if beyond.any():
            index_of = tuple(np.argwhere(beyond)[0])
            entry = index_of[-1]
            raise ArgumentError(
                f"control: {names[entry]} out of bounds; wanted between {self.low[entry]:g} and {self.high[entry]:g}, "
                f"got {controls[index_of]:g}."
            )
        return controls


def entry_names(layout: Layout) -> list[str]:
    """Return the name of each entry, without its unit; parts of one number without an index."""
    names = []
    for part in layout.slices:
        indexed = [f"{part.name}[{number}]" for number in range(part.size)]
        names += indexed if part.size > 1 else [part.name]
    return names


def entry_units(layout: Layout) -> list[str]:
    """Return the unit of each entry."""
    return [part.unit for part in layout.slices for _ in range(part.size)]
