"""Clips and controls as CSV: a header of names and units, one row per time."""

from __future__ import annotations

import csv
import io
from itertools import zip_longest
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import read_bounded, write_whole
from neuroanimator.files.clock import resolution_of, straightened
from neuroanimator.files.number_table import read_header, read_numbers
from neuroanimator.state.layout import Layout
from neuroanimator.text import quoted, table_cell

MAX_TABLE = 256 * 2**20
"""Maximum size of a table read back [bytes]: an hour of the largest body at 30 images a second."""

MAX_HEADER = 400
"""Maximum number of characters of the right header that an error shows."""

OTHER_RATE = 0.01
"""Difference of an interval between controls from a super step, as a share of it, from which they are of another rate."""

UNEVEN = 1e-4
"""Largest difference of an interval from the first one, as a share of it: tables hold nine digits."""


def write_table(
    path: Path, times: Float[np.ndarray, " T"], rows: Float[np.ndarray, "T N"], layout: Layout
) -> None:
    """Write `rows` at `times` [s] to `path`, under the layout's names."""
    lines = [header_of(layout)]
    for time, row in zip(times, rows, strict=True):
        lines.append(",".join(f"{value:.9g}" for value in (time, *row)))
    lines.append("")
    write_whole(path, "\n".join(lines).encode())


def header_of(layout: Layout) -> str:
    """Return a table's first line: one cell per column, also for unusual names in the layout."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(_column_names(layout))
    return line.getvalue()


def _column_names(layout: Layout) -> list[str]:
    return [table_cell(name) for name in ("time s", *layout.names)]


def read_table(
    path: Path, layout: Layout
) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, "T N"]]:
    """Return (times [s], rows) of a table written for `layout`; BadFileError names the line that is wrong.

    Times that can mean a constant rate, by the digits they are written with, are at that rate.
    """
    content = read_bounded(path, MAX_TABLE)
    columns = _column_names(layout)
    header = read_header(content, lambda cells: cells == columns, str(path))
    for column, (name, given) in enumerate(zip_longest(columns, header.cells, fillvalue="")):
        if name != given:
            raise BadFileError(
                f"{path}, column {column + 1}: wanted {quoted(name)}, got {quoted(given)}. A table has the numbers of this body, "
                f"its joints in this order: wanted the header {quoted(header_of(layout), MAX_HEADER)}."
            )
    table = read_numbers(content, header, range(len(columns)), str(path))
    if not len(table.lines):
        raise BadFileError(f"{path} holds no rows below its header.")
    times = table.values[:, 0]
    return straightened(times, resolution_of(times, table.places)), table.values[:, 1:]


def write_controls(path: Path, controls: Float[np.ndarray, "T C"], emulator: Emulator) -> None:
    """Write the controls of `emulator`'s super steps to `path`."""
    write_table(path, np.arange(len(controls)) * emulator.dt, controls, emulator.control)


def read_controls(path: Path, emulator: Emulator) -> Float[np.ndarray, "T C"]:
    """Return the controls in a table written for `emulator`, one per super step; BadFileError for a table at another rate."""
    times, controls = read_table(path, emulator.control)
    intervals = np.diff(times)
    wrong = np.flatnonzero(np.abs(intervals - emulator.dt) > OTHER_RATE * emulator.dt)
    if len(wrong):
        row = int(wrong[0]) + 1
        raise BadFileError(
            f"{path}, row {row}: {intervals[row - 1]:.6g} s after the row before; wanted {emulator.dt:g} s, a super step of "
            f"{emulator.system}. Resample the controls, or use the emulator that they were found for."
        )
    return controls


def write_clip(clip: Clip, path: str | Path, layout: Layout) -> None:
    """Write `clip` to `path` as a table of its states."""
    path = Path(path)
    write_table(path, clip.times, clip.states, layout)


def read_clip(path: str | Path, emulator: Emulator) -> Clip:
    """Return the clip that `write_clip` wrote of a motion of `emulator`'s system."""
    path = Path(path)
    times, states = read_table(path, emulator.state)
    steps = np.diff(times)
    if len(times) < 2 or steps[0] <= 0 or not np.allclose(steps, steps[0], rtol=UNEVEN):
        raise BadFileError(f"{path}: wanted at least two evenly spaced, rising times.")
    return Clip(emulator.system, emulator.skeleton, times, states)
