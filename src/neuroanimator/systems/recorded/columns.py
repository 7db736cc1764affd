"""The contents of a recording in any format, and the names of its columns."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped

from neuroanimator.errors import BadFileError
from neuroanimator.files.names import PART_PATTERN
from neuroanimator.state.units import known_unit
from neuroanimator.text import quoted

MAX_COLUMNS = 514
"""Maximum number of columns: 256 parts of the state and 256 of the control, as in a definition, a run and a time."""

MAX_MAGNITUDE = 1e30
"""Bound on the magnitude of numbers in a recording: beyond it, sums and differences in single precision overflow."""

MAX_SHOWN = 40
"""Maximum number of characters of a wrong cell shown in an error."""


@dataclass(frozen=True)
class Samples:
    """The rows of a recording, in the file's order."""

    run: Shaped[np.ndarray, " N"]
    """Label of the run of each row, of any type."""
    time: Float[np.ndarray, " N"]
    """Time of each row [s]."""
    states: Float[np.ndarray, "N S"]
    """State in each row."""
    controls: Float[np.ndarray, "N C"]
    """Control in each row."""
    state: tuple[tuple[str, str], ...]
    """(name, unit) of each state entry."""
    control: tuple[tuple[str, str], ...]
    """(name, unit) of each control entry."""
    lines: Int[np.ndarray, " N"] | None = None
    """Line number of each row, if the file is text."""

    def where(self, row: int) -> str:
        """Return the place of a row in the file, in words."""
        return where_in_file(self.lines, row)


def where_in_file(lines: Int[np.ndarray, " N"] | None, row: int) -> str:
    """Return the place of a row in the file, in words; `lines` are the rows' line numbers if it is text."""
    if lines is None:
        return f"row {row}"
    return f"line {lines[row]}"


def without_brackets(text: str) -> str:
    """Return `angle rad` for `angle [rad]` and `angle (rad)`, as many programs write it; any other text unchanged."""
    return re.sub(r"\s*[\[(]([^\[\]()]+)[\])]$", r" \1", text.strip())


def name_and_unit(text: str, where: str) -> tuple[str, str]:
    """Return (name, unit) of a column called like `angle rad`; BadFileError says `where` it is not."""
    name, _, unit = without_brackets(text).partition(" ")
    if not re.fullmatch(PART_PATTERN, name) or not unit.strip():
        raise BadFileError(
            f"{where}: wanted a name and a unit such as 'angle rad', got {quoted(text, MAX_SHOWN)}."
        )
    return name, known_unit(unit.strip(), where)


def refuse_columns(name: str, state: list[tuple[str, str]], control: list[tuple[str, str]]) -> None:
    """Raise BadFileError for names that clash, and for recordings without a state. A free swing has no control."""
    if not state:
        raise BadFileError(
            f"{name}: no state column. Name at least one, such as 'state.angle rad'."
        )
    _refuse_names(name, "state", [column for column, _ in state])
    _refuse_names(name, "control", [column for column, _ in control])


def _refuse_names(file: str, vector: str, names: list[str]) -> None:
    if len(names) > MAX_COLUMNS:
        raise BadFileError(
            f"{file}: {len(names):,} {vector} columns; wanted at most {MAX_COLUMNS}. Leave some out."
        )
    for name in names:
        if names.count(name) > 1:
            raise BadFileError(
                f"{file}: two columns are called '{vector}.{name}'. Rename one of them."
            )
