"""Checks of TOML files: tables of known keys, numbers with limits, and errors that name the key."""

from __future__ import annotations

import reprlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import one_line, read_bounded
from neuroanimator.files.numbers import MIN_STEP
from neuroanimator.files.toml_text import MAX_TOML, parse_toml
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
