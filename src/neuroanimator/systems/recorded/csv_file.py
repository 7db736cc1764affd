"""Recordings as CSV: a header of names and units, then a line for each sample.

Cells may be separated by semicolons or tabs, too; numbers may then have decimal commas.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import one_line
from neuroanimator.files.csv_text import csv_rows
from neuroanimator.files.numbers import number_in
from neuroanimator.systems.recorded.columns import (
    MAX_COLUMNS,
    MAX_MAGNITUDE,
    MAX_SHOWN,
    Samples,
    name_and_unit,
    refuse_columns,
    without_brackets,
)

HEADER = "run,time s,state.angle rad,state.velocity rad/s,control.torque N·m"
"""Example of a header shown in errors."""

RUN = "run"
"""Name of the column of runs' labels."""

TIME = "time s"
"""Name of the column of times."""

DELIMITERS = (",", ";", "\t")
"""Separators of cells: the first of these with which the header has a column of times is used."""

REMARK = "#"
"""Prefix of remarks: lines before the header that begin with it, and empty ones, are skipped."""

MAX_REMARKS = 1000
"""Maximum number of skipped lines, so that a file of only line breaks is refused at once."""


@dataclass(frozen=True)
class _Header:
    """The meaning of the file's columns."""

    cells: list[str]
    has_decimal_commas: bool
    """Whether numbers have decimal commas, which is impossible if commas separate the cells."""
    run: int | None
    """Column of the run's label, if there is one."""
    time: int
    """Column of the time."""
    states: dict[int, tuple[str, str]]
    """(name, unit) by the column of each state entry."""
    controls: dict[int, tuple[str, str]]
    """(name, unit) by the column of each control entry."""


def read_csv(content: bytes, name: str) -> Samples:
    """Return the samples in a CSV file; BadFileError names line, column and fix."""
    try:
        delimiter = _delimiter(content, name)
        rows = csv_rows(content, delimiter)
        line, cells = _first(rows, name)
        header = _header(cells, delimiter, f"{name}, line {line}")
        return _samples(header, rows, name)
    except ValueError as error:
        raise BadFileError(f"{name}, {one_line(error)}.") from error


def _delimiter(content: bytes, name: str) -> str:
    """Return the separator of the header's cells; a comma if none of `DELIMITERS` gives a column of times."""
    for delimiter in DELIMITERS:
        _, cells = _first(csv_rows(content, delimiter), name)
        if TIME in cells:
            return delimiter
    return DELIMITERS[0]


def _first(rows: Iterator[tuple[int, list[str]]], name: str) -> tuple[int, list[str]]:
    """Return the line number of the header and its cells, units without brackets."""
    line = 0
    for line, cells in islice(rows, MAX_REMARKS):
        if cells and not cells[0].startswith(REMARK):
            return line, [without_brackets(cell) for cell in cells]
    if line:
        raise BadFileError(
            f"{name}: no column 'time s' in {line:,} lines. Wanted a header such as '{HEADER}'."
        )
    raise BadFileError(f"{name} is empty. It should begin with a header such as '{HEADER}'.")


def _samples(header: _Header, rows: Iterator[tuple[int, list[str]]], name: str) -> Samples:
    columns = [header.time, *header.states, *header.controls]
    labels: dict[str, int] = {}
    # Typed arrays: Python's lists would take five times the memory.
    runs = array("q")
    lines = array("q")
    numbers = array("d")
    for line, cells in rows:
        if not cells:
            continue
        numbers.extend(_row(cells, columns, header, f"{name}, line {line}"))
        lines.append(line)
        label = ""
        if header.run is not None:
            label = cells[header.run].strip()
        runs.append(labels.setdefault(label, len(labels)))
    table = np.array(numbers).reshape(-1, len(columns))
    middle = 1 + len(header.states)
    return Samples(
        run=np.array(runs, int),
        time=table[:, 0],
        states=table[:, 1:middle],
        controls=table[:, middle:],
        state=tuple(header.states.values()),
        control=tuple(header.controls.values()),
        lines=np.array(lines, int),
    )


def _header(cells: list[str], delimiter: str, place: str) -> _Header:
    """Return the meaning of the columns; BadFileError begins with `place`, the header's file and line."""
    if len(cells) > MAX_COLUMNS:
        raise BadFileError(
            f"{place}: {len(cells):,} columns; wanted at most {MAX_COLUMNS}. Leave some out."
        )
    if TIME not in cells:
        raise BadFileError(f"{place}: no column 'time s'. Wanted a header such as '{HEADER}'.")
    states: dict[int, tuple[str, str]] = {}
    controls: dict[int, tuple[str, str]] = {}
    for column, cell in enumerate(cells):
        where = f"{place}, column {column + 1}"
        if cell.startswith("state."):
            states[column] = name_and_unit(cell.removeprefix("state."), where)
        elif cell.startswith("control."):
            controls[column] = name_and_unit(cell.removeprefix("control."), where)
        elif cell not in (RUN, TIME):
            raise BadFileError(
                f"{where}: {cell[:MAX_SHOWN]!r} is none of run, time s, state.NAME UNIT, control.NAME UNIT."
            )
    for cell in (RUN, TIME):
        if cells.count(cell) > 1:
            raise BadFileError(f"{place}: two columns are called '{cell}'. Remove one of them.")
    refuse_columns(place, list(states.values()), list(controls.values()))
    run = None
    if RUN in cells:
        run = cells.index(RUN)
    return _Header(
        cells=cells,
        has_decimal_commas=delimiter != ",",
        run=run,
        time=cells.index(TIME),
        states=states,
        controls=controls,
    )


def _row(cells: list[str], columns: list[int], header: _Header, where: str) -> list[float]:
    if len(cells) != len(header.cells):
        raise BadFileError(
            f"{where}: {len(cells)} cells; wanted {len(header.cells)}, as in the header. Correct the row."
        )
    numbers = []
    for column in columns:
        cell_place = f"{where}, column {column + 1} ({header.cells[column]})"
        cell = cells[column]
        if header.has_decimal_commas:
            cell = cell.replace(",", ".")
        numbers.append(_number(cell, cell_place))
    return numbers


def _number(cell: str, where: str) -> float:
    try:
        value = number_in(cell)
    except ValueError:
        value = math.nan
    if not abs(value) < MAX_MAGNITUDE:  # True for NaN
        raise BadFileError(
            f"{where}: wanted a finite number, got {cell[:MAX_SHOWN]!r}. Fill it in, or begin a new run after it."
        )
    return value
