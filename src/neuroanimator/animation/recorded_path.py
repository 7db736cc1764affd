"""Paths recorded elsewhere, such as a character's clip: a CSV table of positions, or a node of a GLB file."""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.glb_motion import node_motion
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import one_line, read_bounded
from neuroanimator.files.csv_text import csv_rows
from neuroanimator.files.glb import read_glb
from neuroanimator.files.numbers import number_in
from neuroanimator.systems.recorded.columns import without_brackets
from neuroanimator.text import did_you_mean, listed, quoted

MAX_TABLE = 64 * 2**20
"""Maximum size of a table [bytes]."""

MAX_SECONDS = 3600.0
"""Maximum duration of a path [s]: an hour."""

MAX_COORDINATE = 1e6
"""Maximum coordinate [m], angle [rad] or time [s]."""

UNITS = {"s": "seconds", "m": "metres", "rad": "radians"}
"""Units of columns, where a header gives any, and their names in messages."""

MAX_GAP = 10.0
"""Ratio of the time between two rows to the usual time above which rows are missing."""

SHORTEST = 1e-6
"""Length below which a quaternion gives no rotation."""

SOURCE = re.compile(r"(?P<file>.*?\.(?P<kind>csv|glb))(?::(?P<part>.+))?", re.IGNORECASE)
"""Pattern of a file, with a part of it after a colon: FILE.csv, FILE.csv:PART or FILE.glb:NODE."""


@dataclass(frozen=True, eq=False)
class RecordedPath:
    """Positions of something over time, and its heading."""

    name: str
    """Its origin, as messages state it."""
    times: Float[np.ndarray, " T"]
    """Increasing times [s]."""
    positions: Float[np.ndarray, "T 3"]
    """Positions [m], Z up."""
    headings: Float[np.ndarray, " T"] | None = None
    """Angle turned about Z, without jumps [rad]; None if not known."""

    def __post_init__(self) -> None:
        columns = [self.times, *self.positions.T]
        if self.headings is not None:
            columns.append(self.headings)
        for column in columns:
            if not (np.abs(column) <= MAX_COORDINATE).all():  # false for NaN, too
                raise BadFileError(
                    f"{self.name}: a number that is not finite or above {MAX_COORDINATE:g}. Remove such rows."
                )
        if len(self.times) < 2:
            raise BadFileError(f"{self.name}: wanted at least two times, got {len(self.times)}.")
        backwards = np.flatnonzero(np.diff(self.times) <= 0)
        if len(backwards):
            before, after = self.times[backwards[0] : backwards[0] + 2]
            raise BadFileError(
                f"{self.name}: wanted rising times, got {after:g} s after {before:g} s. Sort the rows, and remove duplicates."
            )
        if self.times[-1] - self.times[0] > MAX_SECONDS:
            raise BadFileError(
                f"{self.name}: {self.times[-1] - self.times[0]:g} s; wanted at most {MAX_SECONDS:g}. Cut it into parts."
            )

    def at(
        self, times: Float[np.ndarray, " F"]
    ) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, " F"] | None]:
        """Return positions [m] and headings [rad] at `times` [s], on straight lines between the rows."""
        columns = [np.interp(times, self.times, column) for column in self.positions.T]
        positions = np.stack(columns, axis=1)
        if self.headings is None:
            return positions, None
        return positions, np.interp(times, self.times, self.headings)


class _Columns(NamedTuple):
    """Indices of a table's columns."""

    time: int
    position: tuple[int, ...]
    orientation: tuple[int, ...]
    """One for a heading, four for a quaternion wxyz, none if the table has neither."""

    @property
    def all(self) -> tuple[int, ...]:
        return (self.time, *self.position, *self.orientation)


def read_path(source: str | Path) -> RecordedPath:
    """Return the path in a file: `walk.csv`, `walk.csv:torso` or `walk.glb:Spine2`.

    A CSV table has columns `time` [s], `x`, `y`, `z` [m], and optionally `heading` [rad] or a quaternion `qw`, `qx`,
    `qy`, `qz`. A name after a colon picks another position: the columns `torso[0]`, `torso[1]`, `torso[2]`, as
    `animate --out x.csv` writes them, with `torso_heading`, or those of `root.position` with `root.orientation`. For a
    GLB file it is the name of a node, whose position in the world is taken along the first animation.

    Raises ArgumentError if `source` names no such file, BadFileError if the file is faulty.
    """
    text = str(source)
    found = SOURCE.fullmatch(text)
    if found is None:
        raise ArgumentError(
            f"path: wanted FILE.csv, FILE.csv:PART or FILE.glb:NODE, got {quoted(text)}."
        )
    path = Path(found["file"])
    if found["kind"].lower() == "csv":
        return _from_csv(path, found["part"])
    if found["part"] is None:
        raise ArgumentError(
            f"path: wanted the name of a node after {quoted(text)}, such as {path.name}:Spine2."
        )
    file = read_glb(path)
    try:
        times, positions, orientations = node_motion(file, found["part"])
    except ValueError as error:
        raise BadFileError(f"{path}: {one_line(error)}.") from error
    return RecordedPath(text, times, positions, _headings(orientations))


def _headings(orientations: Float[np.ndarray, "T 4"]) -> Float[np.ndarray, " T"]:
    """Return the angles by which quaternions wxyz turn about Z [rad], whatever their tilt, without jumps."""
    return np.unwrap(2 * np.arctan2(orientations[:, 3], orientations[:, 0]))


def _from_csv(path: Path, part: str | None) -> RecordedPath:
    rows = csv_rows(read_bounded(path, MAX_TABLE))
    numbers = array("d")
    try:
        _, header = next(rows, (0, []))
        columns = _columns(header, part, str(path))
        for line, cells in rows:
            if cells:
                numbers.extend(_row(cells, columns, len(header), f"{path}, line {line}"))
    except ValueError as error:
        raise BadFileError(f"{path}, {one_line(error)}.") from error
    table = np.array(numbers).reshape(-1, len(columns.all))
    _refuse_gaps(table[:, 0], path)
    turned = table[:, 4:]
    headings = None
    if len(columns.orientation) == 1:
        headings = turned[:, 0]
    elif columns.orientation:
        if (np.linalg.norm(turned, axis=1) < SHORTEST).any():
            raise BadFileError(f"{path}: a quaternion of zeros is no rotation. Remove the row.")
        headings = _headings(turned)
    return RecordedPath(str(path), table[:, 0], table[:, 1:4], headings)


def _refuse_gaps(times: Float[np.ndarray, " T"], path: Path) -> None:
    intervals = np.diff(times)
    gaps = np.flatnonzero(intervals > MAX_GAP * np.median(intervals)) if len(intervals) else []
    if len(gaps):
        before, after = times[gaps[0] : gaps[0] + 2]
        raise BadFileError(
            f"{path}: nothing between {before:g} s and {after:g} s. Fill the gap, or split the table there."
        )


def _columns(header: list[str], part: str | None, where: str) -> _Columns:
    """Return the indices of the columns; BadFileError if some are missing, or in another unit."""
    units: dict[str, str] = {}
    names = []
    for cell in header:
        name, _, unit = without_brackets(cell).partition(" ")
        names.append(name)
        units[name] = unit.strip()
    position, turns = _names_of(part)
    missing = [name for name in ("time", *position) if name not in names]
    if missing:
        known = listed(quoted(name) for name in names)
        guess = did_you_mean(missing[0], names)
        raise BadFileError(
            f"{where}: no column {quoted(missing[0])}. {guess}Columns: {known or 'none'}."
        )
    orientation: tuple[str, ...] = ()
    for choice in turns:
        if not orientation and all(name in names for name in choice):
            orientation = choice
    expected = {"time": "s"} | dict.fromkeys(position, "m")
    if len(orientation) == 1:
        expected[orientation[0]] = "rad"
    for name, unit in expected.items():
        if units[name] not in ("", unit):
            raise BadFileError(
                f"{where}: {quoted(name)} is in {quoted(units[name])}. Convert it to {UNITS[unit]}."
            )
    used = (*expected, *orientation)
    twice = [name for name in used if names.count(name) > 1]
    if twice:
        raise BadFileError(f"{where}: two columns are called {quoted(twice[0])}. Rename one.")
    return _Columns(
        names.index("time"),
        tuple(names.index(name) for name in position),
        tuple(names.index(name) for name in orientation),
    )


def _names_of(part: str | None) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Return the column names of a position, and the alternatives for an orientation, the preferred one first."""
    if part is None:
        return ("x", "y", "z"), (("heading",), ("qw", "qx", "qy", "qz"))
    position = tuple(f"{part}[{axis}]" for axis in range(3))
    body = part.removesuffix(".position")
    quaternion = tuple(f"{body}.orientation[{entry}]" for entry in range(4))
    return position, ((f"{part}_heading[0]",), quaternion)


def _row(cells: list[str], columns: _Columns, count: int, where: str) -> list[float]:
    if len(cells) != count:
        raise BadFileError(
            f"{where}: {len(cells)} cells; wanted {count}, as in the header. Correct the row."
        )
    try:
        return [number_in(cells[column]) for column in columns.all]
    except ValueError as error:
        raise BadFileError(f"{where}: wanted numbers, got {quoted(','.join(cells))}.") from error
