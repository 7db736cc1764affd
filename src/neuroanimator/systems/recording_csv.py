"""Recordings as CSV."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass

import numpy as np

from neuroanimator.errors import BadFileError
from neuroanimator.systems.recording_columns import Samples, name_and_unit, refuse_columns

HEADER = "run,time s,state.angle rad,state.speed rad/s,control.torque N·m"


@dataclass(frozen=True)
class _Header:
    cells: list[str]
    run: int | None
    """Column of the run's label."""
    time: int
    states: dict[int, tuple[str, str]]
    """Column: (name, unit)."""
    controls: dict[int, tuple[str, str]]


def read_csv(content: bytes, name: str) -> Samples:
    """Return the samples in a CSV file; BadFileError names line, column and fix."""
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise BadFileError(
            f"{name} is not text in UTF-8: {error.reason} at byte {error.start}. Save it as CSV."
        ) from error
    if not lines:
        raise BadFileError(f"{name} is empty. It should begin with a header such as '{HEADER}'.")
    header = _header(_cells(lines[0]), name)
    columns = [header.time, *header.states, *header.controls]
    labels, table, numbers = [], [], []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        cells = _cells(line)
        table.append(_row(cells, columns, header, f"{name}, line {number}"))
        labels.append("" if header.run is None else cells[header.run].strip())
        numbers.append(number)
    rows = np.array(table, float).reshape(-1, len(columns))
    middle = 1 + len(header.states)
    parts = rows[:, 0], rows[:, 1:middle], rows[:, middle:]
    named = tuple(header.states.values()), tuple(header.controls.values())
    return Samples(np.array(labels), *parts, *named, np.array(numbers, int))


def _cells(line: str) -> list[str]:
    return next(csv.reader([line]), [])


def _header(cells: list[str], name: str) -> _Header:
    cells = [cell.strip() for cell in cells]
    if "time s" not in cells:
        raise BadFileError(f"{name}, line 1: no column 'time s'. Wanted a header such as '{HEADER}'.")
    states, controls = {}, {}
    for column, cell in enumerate(cells):
        where = f"{name}, line 1, column {column + 1}"
        for prefix, found in (("state.", states), ("control.", controls)):
            if cell.startswith(prefix):
                found[column] = name_and_unit(cell.removeprefix(prefix), where)
        if cell not in ("run", "time s") and not cell.startswith(("state.", "control.")):
            raise BadFileError(f"{where}: '{cell[:40]}' is none of run, time s, state.NAME UNIT, control.NAME UNIT.")
    for cell in ("run", "time s"):
        if cells.count(cell) > 1:
            raise BadFileError(f"{name}, line 1: two columns are called '{cell}'. Remove one of them.")
    refuse_columns(f"{name}, line 1", list(states.values()), list(controls.values()))
    return _Header(cells, cells.index("run") if "run" in cells else None, cells.index("time s"), states, controls)


def _row(cells: list[str], columns: list[int], header: _Header, where: str) -> list[float]:
    if len(cells) != len(header.cells):
        raise BadFileError(
            f"{where}: {len(cells)} cells; wanted {len(header.cells)}, as in the header. Correct the row."
        )
    return [_number(cells[column], f"{where}, column {column + 1} ({header.cells[column]})") for column in columns]


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadFileError(
            f"{where}: wanted a finite number, came '{cell[:40]}'. Fill it in, or begin a new run after it."
        )
    return value
