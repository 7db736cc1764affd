"""Recordings as CSV: a header of names and units, then a line for each sample.

Cells may be separated by semicolons or tabs, too; numbers may have decimal commas, and separators of thousands.
"""

from __future__ import annotations

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import one_line
from neuroanimator.files.clock import resolution_of
from neuroanimator.files.number_table import Header, read_header, read_numbers
from neuroanimator.state.columns import (
    Samples,
    Vocabulary,
    columns_of,
    samples_of,
    seconds,
    time_column,
)

HEADER = "run,time s,state.angle rad,state.velocity rad/s,control.torque N·m"
"""Example of a header shown in errors."""

RUN = "run"
"""Name of the column of runs' labels."""


def read_csv(content: bytes, name: str, vocabulary: Vocabulary | None = None) -> Samples:
    """Return the samples in a CSV file; BadFileError names line, column and fix."""
    try:
        header = read_header(content, lambda cells: any(map(time_column, cells)))
    except ValueError as error:
        raise BadFileError(f"{name}, {one_line(error)}.") from error
    time, run = _clocks(header, name)
    where = f"{name}, line {header.line}"
    numbers = [number for number in range(len(header.cells)) if number not in (time, run)]
    cells = {f"{where}, column {number + 1}": header.cells[number] for number in numbers}
    columns = columns_of(cells, vocabulary, where)
    table = read_numbers(content, header, [time, *numbers], name, run)
    clock = time_column(header.cells[time])
    assert clock is not None
    times = table.values[:, 0]
    timing = seconds(times, clock, f"{where}, column {time + 1}")
    resolution = resolution_of(times, table.places)
    return samples_of(table.labels, timing, resolution, table.values[:, 1:], columns, table.lines)


def _clocks(header: Header, name: str) -> tuple[int, int | None]:
    """Return the columns of the time, and of the run's label if there is one."""
    if not header.line:
        raise BadFileError(f"{name} is empty. It should begin with a header such as '{HEADER}'.")
    times = [number for number, cell in enumerate(header.cells) if time_column(cell)]
    runs = [number for number, cell in enumerate(header.cells) if cell.strip() == RUN]
    where = f"{name}, line {header.line}"
    if not times:
        raise BadFileError(f"{where}: no column 'time s'. Wanted a header such as '{HEADER}'.")
    for label, found in (("time", times), (RUN, runs)):
        if len(found) > 1:
            raise BadFileError(f"{where}: two columns are called '{label}'. Remove one of them.")
    return times[0], (runs or [None])[0]
