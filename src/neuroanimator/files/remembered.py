"""A weak cache: values made from objects, kept as long as the objects live.

Keyed by address: modules of equinox are slow to compare, and cannot be hashed.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from functools import update_wrapper
from typing import Any, Generic, TypeVar

Value = TypeVar("Value")


class Remembered(Generic[Value]):
    """A function of an object and of further keys, whose result is kept until the object is gone."""

    def __init__(self, function: Callable[..., Value]) -> None:
        self._function = function
        self._values: dict[Hashable, tuple[weakref.ref[Any], Value]] = {}
        update_wrapper(self, function)

    def __len__(self) -> int:
        return len(self._values)

    def __call__(self, thing: Any, *further: Hashable) -> Value:
        """Return the function's value, computed at the first call."""
        key = (id(thing), *further)
        known = self._values.get(key)
        if known is not None and known[0]() is thing:
            return known[1]
        value = self._function(thing, *further)
        self._values[key] = (weakref.ref(thing, lambda _: self._values.pop(key, None)), value)
        return value

    def knows(self, thing: Any) -> bool:
        """Return whether a call with `thing` alone has nothing left to compute."""
        known = self._values.get((id(thing),))
        return known is not None and known[0]() is thing
