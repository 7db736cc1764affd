"""The command line as users write it: lists of numbers, and errors of one line each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import typer

from neuroanimator.errors import ArgumentError
from neuroanimator.files.numbers import whole_in

UsageError: type[Exception] = next(
    kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "UsageError"
)
"""Exception that typer raises for a wrong command line; typer gives it no public name."""

SECONDS_A_MINUTE = 60

MAX_MINUTES = 10_000
"""Maximum of `--minutes`, above which it is a typing error: a week."""

MAX_SHOWN = 40
"""Maximum number of characters of a wrong text shown in an error."""


@contextmanager
def usage_in_one_line() -> Iterator[None]:
    """Turn an error of the command line into an ArgumentError that says where to find help."""
    try:
        yield
    except UsageError as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            raise
        format_message = getattr(error, "format_message", error.__str__)
        said = str(format_message()).rstrip(".")
        stop = "" if said.endswith("?") else "."
        context = getattr(error, "ctx", None)
        command = "neuroanimator"
        if context is not None and context.parent:
            command += f" {context.info_name}"
        raise ArgumentError(f"{said}{stop} '{command} --help' lists the options.") from error


def refuse_given(options: Mapping[str, object], reason: str) -> None:
    """Refuse the first of `options` that is given; the error states its name and `reason`."""
    for name, value in options.items():
        if is_given(value):
            raise ArgumentError(f"{name}: {reason}")


def is_given(value: object) -> bool:
    """Return whether an option has a `value`: it is not None, off or empty."""
    return value is not None and value is not False and value != []


def check_minutes(minutes: float) -> None:
    """Refuse the value of `--minutes` if there is no such time."""
    if not 0 < minutes <= MAX_MINUTES:
        raise ArgumentError(
            f"minutes: wanted more than 0, at most {MAX_MINUTES:,}, got {minutes:g}."
        )


def whole_numbers(name: str, text: str) -> tuple[int, ...]:
    """Return the numbers in a text such as `96,64`; ArgumentError names the option."""
    try:
        return tuple(whole_in(part) for part in text.split(","))
    except ValueError as error:
        raise ArgumentError(
            f"{name}: wanted numbers such as 96,64, got {text[:MAX_SHOWN]!r}."
        ) from error
