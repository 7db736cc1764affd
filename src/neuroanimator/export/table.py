"""Clips and controls as CSV: a header of names and units, one row per time."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.files import write_whole
from neuroanimator.systems.layout import Layout
from neuroanimator.text import quoted, table_cell

LONGEST_HEADER = 400
"""Characters of a wanted header that an error shows."""


def write_table(path: Path, times: np.ndarray, rows: np.ndarray, layout: Layout) -> None:
    """Write `rows` (T, N) at `times` (T,) [s] under the layout's names."""
    header = header_of(layout)
    lines = [",".join(f"{value:.9g}" for value in (time, *row)) for time, row in zip(times, rows, strict=True)]
    write_whole(path, "\n".join([header, *lines, ""]).encode())


def header_of(layout: Layout) -> str:
    """Return a table's first line: one cell per column, whatever is in the layout's names."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow([table_cell(name) for name in ("time s", *layout.names)])
    return line.getvalue()


def read_table(path: Path, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Return (times, rows) of a table written for `layout`; BadFileError names the line that is wrong."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadFileError(f"Could not read {path}: {error}. Check the path.") from error
    wanted = header_of(layout)
    if not lines or lines[0] != wanted:
        raise BadFileError(f"{path}: wanted the header {quoted(wanted, LONGEST_HEADER)}.")
    columns = 1 + layout.size
    numbers = [_numbers(path, number, line, columns) for number, line in enumerate(lines[1:], start=2)]
    if not numbers:
        raise BadFileError(f"{path} holds no rows below its header.")
    table = np.array(numbers)
    return table[:, 0], table[:, 1:]


def _numbers(path: Path, number: int, line: str, count: int) -> list[float]:
    try:
        values = [float(cell) for cell in line.split(",")]
    except ValueError as error:
        raise BadFileError(f"{path}, line {number}: {error}.") from error
    if len(values) != count or not np.isfinite(values).all():
        raise BadFileError(f"{path}, line {number}: wanted {count} finite numbers, came {quoted(line)}.")
    return values


def write_clip(clip: Clip, path: Path, layout: Layout) -> None:
    """Write `clip` as a table of its states."""
    write_table(path, clip.times, clip.states, layout)


def read_clip(path: Path, emulator: Emulator) -> Clip:
    """Return the clip that `write_clip` wrote of a motion of `emulator`'s system."""
    times, states = read_table(path, emulator.identity.state)
    if len(times) < 2 or not np.allclose(np.diff(times), times[1] - times[0], rtol=1e-4) or times[1] <= times[0]:
        raise BadFileError(f"{path}: wanted at least two evenly spaced, rising times.")
    return Clip(emulator.identity.system, emulator.identity.skeleton, times, states)
