"""What every recording holds, whatever its format, and how its columns are named."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from neuroanimator.errors import BadFileError
from neuroanimator.parsing.names import PART_PATTERN
from neuroanimator.state.units import known_unit
from neuroanimator.text import quoted

MAX_COLUMNS = 514
"""A definition has room for 256 parts of the state and 256 of the control; a run and a time beside them."""

MAX_MAGNITUDE = 1e30
"""In a recording: beyond it, sums and differences in single precision overflow."""


@dataclass(frozen=True)
class Samples:
    """The rows of a recording, in the file's order."""

    run: np.ndarray
    """(N,) labels of any kind."""
    time: np.ndarray
    """(N,) [s]"""
    states: np.ndarray
    """(N, S)"""
    controls: np.ndarray
    """(N, C)"""
    state: tuple[tuple[str, str], ...]
    """(name, unit) of each state entry."""
    control: tuple[tuple[str, str], ...]
    lines: np.ndarray | None = None
    """(N,) line numbers of a text file."""

    def where(self, row: int) -> str:
        """Return where the row lies, for people."""
        return f"row {row}" if self.lines is None else f"line {self.lines[row]}"


def name_and_unit(text: str, where: str) -> tuple[str, str]:
    """Return (name, unit) of a column called `angle rad`; BadFileError says `where` it is not."""
    name, _, unit = text.strip().partition(" ")
    if not re.fullmatch(PART_PATTERN, name) or not unit.strip():
        raise BadFileError(
            f"{where}: wanted a name and a unit such as 'angle rad', came {quoted(text, 40)}."
        )
    return name, known_unit(unit.strip(), where)


def refuse_columns(name: str, state: list[tuple[str, str]], control: list[tuple[str, str]]) -> None:
    """Refuse names that clash and recordings without a state or a control."""
    for kind, columns in (("state", state), ("control", control)):
        names = [column for column, _ in columns]
        if len(names) > MAX_COLUMNS:
            raise BadFileError(
                f"{name}: {len(names):,} {kind} columns; wanted at most {MAX_COLUMNS}. Leave some out."
            )
        if not names:
            example = "state.angle rad" if kind == "state" else "control.torque N·m"
            raise BadFileError(f"{name}: no {kind} column. Name at least one, such as '{example}'.")
        for column in names:
            if names.count(column) > 1:
                raise BadFileError(
                    f"{name}: two columns are called '{kind}.{column}'. Rename one of them."
                )
