"""A weak cache: values made from objects, kept as long as the objects live.

Keyed by address: modules of equinox are slow to compare, and cannot be hashed.
"""

from __future__ import annotations

import weakref
from collections.abc import Hashable
from typing import Any, Generic, TypeVar

Value = TypeVar("Value")

UNKNOWN: Any = object()
"""Stands for a missing value."""


class Remembered(Generic[Value]):
    """Values by the object they were made from, and by further keys; a value is dropped with its object."""

    def __init__(self) -> None:
        self._values: dict[Hashable, tuple[weakref.ref[Any], Value]] = {}

    def __len__(self) -> int:
        return len(self._values)

    def of(self, thing: Any, *further: Hashable) -> Value:
        """Return the value of `thing`, or `UNKNOWN`."""
        found = self._values.get((id(thing), *further))
        if found is not None and found[0]() is thing:
            return found[1]
        return UNKNOWN

    def keep(self, value: Value, thing: Any, *further: Hashable) -> Value:
        """Remember `value` as that of `thing`, and return it."""
        key = (id(thing), *further)
        self._values[key] = (weakref.ref(thing, lambda _: self._values.pop(key, None)), value)
        return value
