"""Rows of a MuJoCo model's arrays that belong to one of its elements: neighbours, of which it gives the first and the number."""

from __future__ import annotations

from typing import SupportsInt


def rows_at(first: SupportsInt, count: SupportsInt) -> slice:
    """Return `count` rows from the `first` one on."""
    return slice(int(first), int(first) + int(count))
