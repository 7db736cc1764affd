"""Foreign text made safe to show: on a terminal, in an error, in a table.

Names from files are checked when they are read (`files/names.py`); this is the second line of defence, at each border.
"""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Iterable
from difflib import get_close_matches

MAX_QUOTE = 60
"""Maximum number of characters of foreign text in an error."""

MAX_LISTED = 12
"""Maximum number of names in an error."""

SMALL_NUMBER = 1e-4
"""Number below which a power of ten is written."""

LARGE_NUMBER = 1e6
"""Number from which a power of ten is written."""

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
"""Characters at the start of a cell that make a spreadsheet run it (OWASP, CSV injection)."""


def printable(text: str) -> str:
    """Return `text` with unprintable characters escaped, such as `\\x1b`.

    These are all control characters (C0, C1, line breaks), marks that reverse the writing direction, and bytes that are
    not text.
    """
    return "".join(letter if letter.isprintable() else _written_out(letter) for letter in text)


def quoted(value: object, limit: int = MAX_QUOTE) -> str:
    """Return foreign text for an error: in quotes, printable, and of at most `limit` characters."""
    shown = str(value)
    if len(shown) > limit:
        shown = shown[:limit] + "..."
    return f"'{printable(shown)}'"


def listed(names: Iterable[str]) -> str:
    """Return the names with commas; of very many the first ones, and the number of others."""
    every = list(names)
    shown = ", ".join(every[:MAX_LISTED])
    if len(every) > MAX_LISTED:
        return f"{shown} and {len(every) - MAX_LISTED} more"
    return shown


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return a question with the one of `names` most similar to `name`, and a blank; empty if none is similar."""
    like = get_close_matches(name, [*names], n=1)
    return f"Did you mean {like[0]}? " if like else ""


def short_number(number: float) -> str:
    """Return a readable number: three significant digits, and a power of ten only instead of many zeros."""
    if not math.isfinite(number):
        return str(number)
    if number and not SMALL_NUMBER <= abs(number) < LARGE_NUMBER:
        return f"{number:.3g}"
    digits = max(0, 2 - math.floor(math.log10(abs(number)))) if number else 0
    text = f"{float(f'{number:.3g}'):.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def table_cell(text: str) -> str:
    """Return the head of a column as one line that no spreadsheet reads as a formula."""
    shown = printable(text)
    if text.startswith(FORMULA_STARTS):
        return "'" + shown
    return shown


def print_line(line: str, *, to_stderr: bool = False) -> None:
    """Print one line, made printable: a result on stdout, or a remark on stderr."""
    print(printable(line), file=sys.stderr if to_stderr else sys.stdout)


def open_streams() -> None:
    """Let results and remarks hold any character: one that the terminal's encoding lacks is escaped, as `\\xb7`."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _written_out(letter: str) -> str:
    return letter.encode("unicode_escape").decode("ascii")
