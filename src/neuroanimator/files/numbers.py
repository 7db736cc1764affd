"""Numbers from a file: of the right kind, finite, and within limits, or a ValueError that names the one at fault."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from neuroanimator.text import quoted

MAX_MAGNITUDE = 1e30
"""Maximum magnitude of a number: emulators and datasets hold float32, whose squares must be finite in some places."""

MIN_STEP = 1e-8
"""Minimum physics step [s]: times closer than a tenth of it count as the same, see `system.TIME_RESOLUTION`."""

T = TypeVar("T")
"""Type of a list's entries."""


def whole(value: Any, what: str, least: int, most: int) -> int:
    """Return `value` if it is a whole number from `least` to `most`."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(
            f"{what}: wanted a whole number from {least:,} to {most:,}, got {quoted(value)}"
        )
    return value


def number(
    value: Any, what: str, least: float = -MAX_MAGNITUDE, most: float = MAX_MAGNITUDE
) -> float:
    """Return `value` if it is a number from `least` to `most`; NaN and infinities are not."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise ValueError(f"{what}: wanted a number from {least:g} to {most:g}, got {quoted(value)}")
    return float(value)


def number_in(text: str) -> float:
    """Return the number in `text`; ValueError also for what only Python accepts: 1_0, digits of other scripts."""
    return float(_plain(text))


def whole_in(text: str) -> int:
    """Return the whole number in `text`, as `number_in` does."""
    return int(_plain(text))


def _plain(text: str) -> str:
    if "_" in text or not text.isascii():
        raise ValueError(f"wanted a number, got {quoted(text)}")
    return text


def flag(value: Any, what: str) -> bool:
    """Return `value` if it is true or false."""
    if not isinstance(value, bool):
        raise ValueError(f"{what}: wanted true or false, got {quoted(value)}")
    return value


def listed(
    value: Any,
    what: str,
    read: Callable[[Any, str], T],
    size: int | None = None,
    most: int | None = None,
) -> tuple[T, ...]:
    """Return a list's entries, each read by `read`; `size` of them, or at `most` so many, if these are given."""
    if not isinstance(value, list | tuple):
        raise ValueError(f"{what}: wanted a list, got {quoted(value)}")
    if size is not None and len(value) != size:
        raise ValueError(f"{what}: wanted {size} entries, got {len(value)}")
    if most is not None and len(value) > most:
        raise ValueError(f"{what}: wanted at most {most} entries, got {len(value)}")
    return tuple(read(entry, what) for entry in value)


def numbers(
    value: Any, what: str, size: int | None = None, most: float = MAX_MAGNITUDE
) -> tuple[float, ...]:
    """Return a list of finite numbers of magnitude up to `most`."""
    return listed(value, what, lambda entry, label: number(entry, label, -most, most), size)


def entries(value: Any, what: str, count: int, size: int | None = None) -> tuple[int, ...]:
    """Return a list of indices below `count`; `size` of them if that is given."""
    return listed(value, what, lambda entry, label: whole(entry, label, 0, count - 1), size)
