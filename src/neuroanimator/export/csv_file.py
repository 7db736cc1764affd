"""Clips and controls as CSV: a header of names and units, one row per time."""

from __future__ import annotations

import csv
import io
from array import array
from pathlib import Path

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.parsing.csv_text import csv_rows
from neuroanimator.state.layout import Layout
from neuroanimator.storage.files import one_line, read_bounded, write_whole
from neuroanimator.systems.recorded.columns import MAX_MAGNITUDE
from neuroanimator.text import quoted, table_cell

MAX_TABLE = 256 * 2**20
"""Largest table read back [bytes]: an hour of the largest body at 30 images a second."""

MAX_HEADER = 400
"""Characters of a wanted header that an error shows."""


def write_table(path: Path, times: np.ndarray, rows: np.ndarray, layout: Layout) -> None:
    """Write `rows` (T, N) at `times` (T,) [s] under the layout's names."""
    header = header_of(layout)
    lines = [
        ",".join(f"{value:.9g}" for value in (time, *row))
        for time, row in zip(times, rows, strict=True)
    ]
    write_whole(path, "\n".join([header, *lines, ""]).encode())


def header_of(layout: Layout) -> str:
    """Return a table's first line: one cell per column, whatever is in the layout's names."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(
        [table_cell(name) for name in ("time s", *layout.names)]
    )
    return line.getvalue()


def read_table(path: Path, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Return (times, rows) of a table written for `layout`; BadFileError names the line that is wrong."""
    rows = csv_rows(read_bounded(path, MAX_TABLE))
    wanted = [table_cell(name) for name in ("time s", *layout.names)]
    numbers = array("d")
    try:
        if next(rows, (0, []))[1] != wanted:
            raise BadFileError(
                f"{path}: wanted the header {quoted(header_of(layout), MAX_HEADER)}."
            )
        for line, cells in rows:
            numbers.extend(_numbers(f"{path}, line {line}", cells, len(wanted)))
    except ValueError as error:
        raise BadFileError(f"{path}, {one_line(error)}.") from error
    if not numbers:
        raise BadFileError(f"{path} holds no rows below its header.")
    table = np.array(numbers).reshape(-1, len(wanted))
    return table[:, 0], table[:, 1:]


def _numbers(where: str, cells: list[str], count: int) -> list[float]:
    try:
        values = [float(cell) for cell in cells]
    except ValueError as error:
        raise BadFileError(f"{where}: {one_line(error)}.") from error
    if len(values) != count or not all(abs(value) < MAX_MAGNITUDE for value in values):
        raise BadFileError(
            f"{where}: wanted {count} finite numbers, came {quoted(','.join(cells))}."
        )
    return values


def write_clip(clip: Clip, path: Path, layout: Layout) -> None:
    """Write `clip` as a table of its states."""
    write_table(path, clip.times, clip.states, layout)


def read_clip(path: Path, emulator: Emulator) -> Clip:
    """Return the clip that `write_clip` wrote of a motion of `emulator`'s system."""
    times, states = read_table(path, emulator.state)
    if (
        len(times) < 2
        or not np.allclose(np.diff(times), times[1] - times[0], rtol=1e-4)
        or times[1] <= times[0]
    ):
        raise BadFileError(f"{path}: wanted at least two evenly spaced, rising times.")
    return Clip(emulator.system, emulator.skeleton, times, states)
