"""Recordings as CSV: a header of names and units, then a line for each sample."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from neuroanimator.errors import BadFileError
from neuroanimator.parsing.csv_text import csv_rows
from neuroanimator.storage.files import one_line
from neuroanimator.systems.recorded.columns import (
    MAX_COLUMNS,
    MAX_MAGNITUDE,
    MAX_SHOWN,
    Samples,
    name_and_unit,
    refuse_columns,
)

HEADER = "run,time s,state.angle rad,state.velocity rad/s,control.torque N·m"
"""The example of a header that errors show."""

RUN = "run"
"""What the column of runs' labels is called."""

TIME = "time s"
"""What the column of times is called."""


@dataclass(frozen=True)
class _Header:
    """Which column of the file holds what."""

    cells: list[str]
    run: int | None
    """The column of the run's label, if there is one."""
    time: int
    """The column of the time."""
    states: dict[int, tuple[str, str]]
    """(name, unit) by the column of each state entry."""
    controls: dict[int, tuple[str, str]]
    """(name, unit) by the column of each control entry."""


def read_csv(content: bytes, name: str) -> Samples:
    """Return the samples in a CSV file; BadFileError names line, column and fix."""
    rows = csv_rows(content)
    try:
        cells = _first(rows, name)
        header = _header(cells, name)
        return _samples(header, rows, name)
    except ValueError as error:
        raise BadFileError(f"{name}, {one_line(error)}.") from error


def _first(rows: Iterator[tuple[int, list[str]]], name: str) -> list[str]:
    for _, cells in rows:
        return cells
    raise BadFileError(f"{name} is empty. It should begin with a header such as '{HEADER}'.")


def _samples(header: _Header, rows: Iterator[tuple[int, list[str]]], name: str) -> Samples:
    columns = [header.time, *header.states, *header.controls]
    labels: dict[str, int] = {}
    # Arrays of machine numbers: lists of Python's would take five times the memory.
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


def _header(cells: list[str], name: str) -> _Header:
    cells = [cell.strip() for cell in cells]
    if len(cells) > MAX_COLUMNS:
        raise BadFileError(
            f"{name}, line 1: {len(cells):,} columns; wanted at most {MAX_COLUMNS}. Leave some out."
        )
    if TIME not in cells:
        raise BadFileError(
            f"{name}, line 1: no column 'time s'. Wanted a header such as '{HEADER}'."
        )
    states: dict[int, tuple[str, str]] = {}
    controls: dict[int, tuple[str, str]] = {}
    for column, cell in enumerate(cells):
        where = f"{name}, line 1, column {column + 1}"
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
            raise BadFileError(
                f"{name}, line 1: two columns are called '{cell}'. Remove one of them."
            )
    refuse_columns(f"{name}, line 1", list(states.values()), list(controls.values()))
    run = None
    if RUN in cells:
        run = cells.index(RUN)
    return _Header(cells, run, cells.index(TIME), states, controls)


def _row(cells: list[str], columns: list[int], header: _Header, where: str) -> list[float]:
    if len(cells) != len(header.cells):
        raise BadFileError(
            f"{where}: {len(cells)} cells; wanted {len(header.cells)}, as in the header. Correct the row."
        )
    numbers = []
    for column in columns:
        cell_place = f"{where}, column {column + 1} ({header.cells[column]})"
        numbers.append(_number(cells[column], cell_place))
    return numbers


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not abs(value) < MAX_MAGNITUDE:  # true for NaN too
        raise BadFileError(
            f"{where}: wanted a finite number, came {cell[:MAX_SHOWN]!r}. Fill it in, or begin a new run after it."
        )
    return value
