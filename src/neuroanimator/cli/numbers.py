"""Lists of numbers on the command line."""

from __future__ import annotations

from neuroanimator.errors import ArgumentError
from neuroanimator.files.numbers import whole_in

MAX_SHOWN = 40
"""Maximum number of characters of a wrong text shown in an error."""


def whole_numbers(name: str, text: str) -> tuple[int, ...]:
    """Return the numbers in a text such as `96,64`; ArgumentError names the option."""
    try:
        return tuple(whole_in(part) for part in text.split(","))
    except ValueError as error:
        raise ArgumentError(
            f"{name}: wanted numbers such as 96,64, got {text[:MAX_SHOWN]!r}."
        ) from error
