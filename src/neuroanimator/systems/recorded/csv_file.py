"""Recordings as CSV."""

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
    Samples,
    name_and_unit,
    refuse_columns,
)

HEADER = "run,time s,state.angle rad,state.velocity rad/s,control.torque N·m"


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
    rows = csv_rows(content)
    try:
        header = _header(_first(rows, name), name)
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
    runs, lines, numbers = array("q"), array("q"), array("d")
    for line, cells in rows:
        if not cells:
            continue
        numbers.extend(_row(cells, columns, header, f"{name}, line {line}"))
        lines.append(line)
        label = "" if header.run is None else cells[header.run].strip()
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
    if "time s" not in cells:
        raise BadFileError(
            f"{name}, line 1: no column 'time s'. Wanted a header such as '{HEADER}'."
        )
    states, controls = {}, {}
    for column, cell in enumerate(cells):
        where = f"{name}, line 1, column {column + 1}"
        for prefix, found in (("state.", states), ("control.", controls)):
            if cell.startswith(prefix):
                found[column] = name_and_unit(cell.removeprefix(prefix), where)
        if cell not in ("run", "time s") and not cell.startswith(("state.", "control.")):
            raise BadFileError(
                f"{where}: {cell[:40]!r} is none of run, time s, state.NAME UNIT, control.NAME UNIT."
            )
    for cell in ("run", "time s"):
        if cells.count(cell) > 1:
            raise BadFileError(
                f"{name}, line 1: two columns are called '{cell}'. Remove one of them."
            )
    refuse_columns(f"{name}, line 1", list(states.values()), list(controls.values()))
    return _Header(
        cells,
        cells.index("run") if "run" in cells else None,
        cells.index("time s"),
        states,
        controls,
    )


def _row(cells: list[str], columns: list[int], header: _Header, where: str) -> list[float]:
    if len(cells) != len(header.cells):
        raise BadFileError(
            f"{where}: {len(cells)} cells; wanted {len(header.cells)}, as in the header. Correct the row."
        )
    return [
        _number(cells[column], f"{where}, column {column + 1} ({header.cells[column]})")
        for column in columns
    ]


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not abs(value) < MAX_MAGNITUDE:  # true for NaN too
        raise BadFileError(
            f"{where}: wanted a finite number, came {cell[:40]!r}. Fill it in, or begin a new run after it."
        )
    return value
