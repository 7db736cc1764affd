"""Checks of TOML files: tables of known keys, numbers with limits, and errors that name the key."""

from __future__ import annotations

import re
import reprlib
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import one_line, read_bounded
from neuroanimator.files.numbers import MIN_STEP
from neuroanimator.text import printable

MAX_SHOWN = 80
"""Maximum number of characters of a key, or of a value, shown in an error."""


Positive = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
"""A number above zero, of a physically plausible size."""

Share = Annotated[float, Field(ge=0, le=1)]
"""A share, from 0 to 1."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
"""A finite number."""

Step = Annotated[float, Field(ge=MIN_STEP, le=0.1)]
"""A physics step [s]."""

MAX_TOML = 512 * 1024
"""Maximum size of a text parsed [characters]; the largest of ours has 8,400."""

DEEPEST = 16
"""Maximum depth of nested lists and tables; ours go four deep."""

MAX_DOTS = 16
"""Maximum number of dots in a key."""

MAX_WORD = 64
"""Maximum number of characters of a number or of a name without quotes; names have at most 40."""

MAX_VALUES = 50_000
"""Maximum number of values, counted by commas and equals signs: each costs time here, in later checks, and in messages."""

TOKEN = re.compile(
    r'(?P<text>"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5})?'
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]|\\[^\n])*+"?'
    r"|'[^'\n]*+'?"
    r"|\#[^\n]*+)"
    r"|(?P<word>[A-Za-z0-9_+-]+)"
    r"|(?P<symbol>[\[\]{}.,=])",
    re.DOTALL,
)
"""A string or comment, whose contents do not matter; a number or name; a symbol of the structure.

A string without end extends to the end of the text or line, as for Python's reader, which then stops. Nothing is tried
twice (`*+`), so the time is proportional to the length of any text.
"""


class Table(BaseModel):
    """A table of a definition: frozen, and unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Settings(Table):
    """A table that users construct: a one-line ArgumentError names the argument at fault."""

    if not TYPE_CHECKING:  # so that editors offer the fields of each subclass as its arguments

        def __init__(self, **values: Any) -> None:
            try:
                super().__init__(**values)
            except ValidationError as error:
                raise ArgumentError(f"{first_fault(error)}.") from error
            self.check()

    def check(self) -> None:
        """Raise ArgumentError if arguments, each valid alone, do not go together."""


def first_fault(error: ValidationError) -> str:
    """Return pydantic's first complaint as one line naming the key."""
    fault = error.errors()[0]
    key = ".".join(str(part) for part in fault["loc"])
    shown_key = printable(key[:MAX_SHOWN])
    given = fault["input"]
    if isinstance(given, list | dict):
        given = reprlib.repr(given)  # of millions of numbers, only those shown
    return f"{shown_key}: {fault['msg'].lower()}, got {str(given)[:MAX_SHOWN]!r}"


def read_toml(path: Path) -> dict[str, Any]:
    """Return the contents of a TOML file, not yet checked."""
    content = read_bounded(path, MAX_TOML)
    try:
        return parse_toml(content)
    except ValueError as error:
        raise BadFileError(f"{path} is not a readable TOML file: {one_line(error)}.") from error


def check_table(values: dict[str, Any], label: str, table: type[BaseModel]) -> Any:
    """Return the values as a checked `table`; ArgumentError names `label` and the key at fault."""
    try:
        return table.model_validate(values)
    except ValidationError as error:
        raise ArgumentError(f"{label}: {first_fault(error)}.") from error


def parse_toml(content: bytes) -> dict[str, Any]:
    """Return the table in `content`, in UTF-8; raises ValueError in one line."""
    if len(content) > MAX_TOML:
        raise ValueError(f"{len(content):,} bytes; wanted at most {MAX_TOML:,}")
    text = content.decode("utf-8-sig")
    _refuse_extremes(text)
    return tomllib.loads(text)


def _refuse_extremes(text: str) -> None:
    """Refuse text that makes Python's reader slow, large or recursive, or numbers too long to print."""
    depth = 0
    dots = 0
    values = 0
    for match in TOKEN.finditer(text):
        kind = match.lastgroup
        token = match.group()
        if kind == "word" and len(token) > MAX_WORD:
            raise ValueError(
                f"line {_line(text, match)}: {len(token):,} characters in a number or name without quotes"
            )
        if kind != "symbol":
            continue
        if token == ".":
            dots += 1
        else:
            dots = 0
            depth += (token in "[{") - (token in "]}")
            values += token in ",="
        if dots > MAX_DOTS:
            raise ValueError(f"line {_line(text, match)}: more than {MAX_DOTS} dots in one key")
        if depth > DEEPEST:
            raise ValueError(f"line {_line(text, match)}: more than {DEEPEST} lists or tables deep")
        if values > MAX_VALUES:
            raise ValueError(
                f"line {_line(text, match)}: more than {MAX_VALUES:,} values. Use a coarser body"
            )


def _line(text: str, match: re.Match[str]) -> int:
    return text.count("\n", 0, match.start()) + 1
