"""Errors of a wrong command line, in one line each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from neuroanimator.errors import ArgumentError

UsageError: type[Exception] = next(
    kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "UsageError"
)
"""What typer raises for a wrong command line; it gives it no public name of its own."""


class Verbs(TyperGroup):
    """The verbs; a wrong command line becomes one line instead of four, like every other mistake."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return what is left of `args` after our own options."""
        with usage_in_one_line():
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the verb."""
        with usage_in_one_line():
            return super().invoke(ctx)


@contextmanager
def usage_in_one_line() -> Iterator[None]:
    """Make an ArgumentError of what is wrong with the command line, saying where help is."""
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
        raise ArgumentError(f"{said}{stop} '{command} --help' shows what there is.") from error
