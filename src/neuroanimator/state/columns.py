"""The contents of a recording in any format, and the meaning of its columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Num, Shaped

from neuroanimator.errors import BadFileError
from neuroanimator.files.clock import Times
from neuroanimator.files.names import PART_PATTERN
from neuroanimator.state.layout import Layout
from neuroanimator.state.units import converted_unit
from neuroanimator.text import did_you_mean, listed, quoted

MAX_COLUMNS = 514
"""Maximum number of columns: 256 parts of the state and 256 of the control, as in a definition, a run and a time."""

MAX_SHOWN = 40
"""Maximum number of characters of a wrong cell shown in an error."""

VECTORS = ("state", "control")
"""What columns may belong to, as their names begin."""

TIME = "time"
"""Name of the column of times."""

MAX_UNNAMED = 1.0
"""Interval from which times without a unit may be something else than seconds."""

TIME_UNITS = {
    "": 1.0,
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "μs": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
}
"""Units of time [s]; none if a column does not say."""

SMALLER = ("ms", "us", "ns")
"""Units in which whole numbers count time."""

FASTEST = 1e-5
"""Smallest usual interval [s]."""

MAX_STEP = 3600.0
"""Largest interval that a definition allows [s]."""

Vocabulary = Mapping[str, Sequence[str]]
"""By vector, the names and units of the numbers of a system, which then need no unit, and no vector, in a recording."""

NamesAndUnits = tuple[tuple[str, str], ...]
"""The name and the unit of each of several numbers."""


class Column(NamedTuple):
    """The meaning of a column."""

    vector: str
    name: str
    unit: str
    """Unit of its numbers once multiplied by `factor`; empty if the column does not say."""
    factor: float = 1.0


@dataclass(frozen=True)
class Samples:
    """The rows of a recording, in the file's order."""

    run: Shaped[np.ndarray, " N"]
    """Label of the run of each row, of any type."""
    time: Times
    """Time of each row since the first one [s]."""
    resolution: Times
    """Smallest difference that each time can tell [s]."""
    states: Float[np.ndarray, "N S"]
    """State in each row."""
    controls: Float[np.ndarray, "N C"]
    """Control in each row."""
    state: NamesAndUnits
    """(name, unit) of each state entry."""
    control: NamesAndUnits
    """(name, unit) of each control entry."""
    lines: Int[np.ndarray, " N"] | None = None
    """Line number of each row, if the file is text."""
    remarks: tuple[str, ...] = ()
    """What was changed as the file was read, for the user."""

    def where(self, row: int) -> str:
        """Return the place of a row in the file, in words."""
        return where_in_file(self.lines, row)


def where_in_file(lines: Int[np.ndarray, " N"] | None, row: int) -> str:
    """Return the place of a row in the file, in words; `lines` are the rows' line numbers if it is text."""
    if lines is None:
        return f"row {row}"
    return f"line {lines[row]}"


def without_brackets(text: str) -> str:
    """Return `angle rad` for `angle [rad]` and `angle (rad)`, as many programs write it; any other text unchanged."""
    return re.sub(r"\s*[\[(]([^\[\]()\d][^\[\]()]*)[\])]$", r" \1", text.strip())


def column_names(layout: Layout) -> list[str]:
    """Return the names of a recording's columns, without `state.` or `control.`."""
    names = []
    for part in layout.slices:
        unit = "1" if part.unit == "quaternion" else part.unit
        indices = [f".{number}" for number in range(part.size)] if part.size > 1 else [""]
        names += [f"{part.name}{index} {unit}" for index in indices]
    return names


def time_column(text: str) -> Column | None:
    """Return the meaning of a column of times; None for any other."""
    name, _, unit = without_brackets(text).replace("_", " ").partition(" ")
    if name.lower() != TIME:
        return None
    unit = unit.strip()
    if unit not in TIME_UNITS:
        return None
    return Column(TIME, TIME, unit, TIME_UNITS[unit])


def columns_of(cells: Mapping[str, str], vocabulary: Vocabulary | None, where: str) -> list[Column]:
    """Return the meaning of the columns of a state and a control, called as `cells` say, by their places in words.

    A name and a unit, `state.angle rad`; with the `vocabulary` of a system whatever tells one of its numbers from all others,
    such as `angle`. BadFileError names the place of a column that means nothing, or several things; `where` is that of all.
    """
    if len(cells) > MAX_COLUMNS:
        raise BadFileError(
            f"{where}: {len(cells):,} columns; wanted at most {MAX_COLUMNS}. Leave some out."
        )
    found = [_meanings(cell, place, vocabulary) for place, cell in cells.items()]
    claimed = [choices[0][:2] for choices in found if len(choices) == 1]
    columns: list[Column] = []
    for (place, cell), choices in zip(cells.items(), found, strict=True):
        left = choices
        if len(choices) > 1:
            left = [choice for choice in choices if choice[:2] not in claimed]
        if len(left) != 1:
            several = listed(f"'{choice.vector}.{choice.name} {choice.unit}'" for choice in choices)
            raise BadFileError(
                f"{place}: {quoted(cell, MAX_SHOWN)} may be {several}. Write the one that is meant."
            )
        columns += left
    meanings = [column[:2] for column in columns]
    for meaning in meanings:
        if meanings.count(meaning) > 1:
            raise BadFileError(
                f"{where}: two columns are called '{'.'.join(meaning)}'. Rename one of them."
            )
    if not any(column.vector == "state" for column in columns):
        raise BadFileError(
            f"{where}: no state column. Name at least one, such as 'state.angle rad'."
        )
    return columns


def _meanings(cell: str, place: str, vocabulary: Vocabulary | None) -> list[Column]:
    """Return what a column may be, at least one: of the numbers of a system those that its name and unit leave."""
    text = without_brackets(cell)
    vector, _, rest = text.partition(".")
    vectors = (vector,)
    if vector not in VECTORS:
        vectors = VECTORS
        rest = text
    name, _, unit = rest.partition(" ")
    factor = 1.0
    if unit:
        unit, factor = converted_unit(unit.strip(), place)
    if vocabulary is not None:
        return _known(name, unit, factor, {kind: vocabulary[kind] for kind in vectors}, place)
    if len(vectors) > 1:
        raise BadFileError(
            f"{place}: {quoted(cell, MAX_SHOWN)} is none of run, time s, state.NAME UNIT, control.NAME UNIT."
        )
    if not unit or not re.fullmatch(PART_PATTERN, name):
        raise BadFileError(
            f"{place}: wanted a name and a unit such as 'angle rad', got {quoted(rest, MAX_SHOWN)}."
        )
    return [Column(vector, name, unit, factor)]


def _known(name: str, unit: str, factor: float, vocabulary: Vocabulary, place: str) -> list[Column]:
    """Return the numbers of a system that `name` and `unit`, if it is given, may be."""
    indexed = re.sub(r"\[(\d+)\]$", r".\1", name)
    known = []
    for vector, numbers in vocabulary.items():
        for number in numbers:
            own, _, inside = number.rpartition(" ")
            known.append(Column(vector, own, inside, factor))
    same = [column for column in known if column.name in (indexed, indexed.removesuffix(".0"))]
    fitting = [column for column in same if unit in ("", column.unit)]
    if fitting:
        return fitting
    if same:
        raise BadFileError(
            f"{place}: column '{same[0].vector}.{name}' is in {unit}, the emulator's in {same[0].unit}. Convert it."
        )
    names = [f"{column.name} {column.unit}" for column in known]
    listing = listed(f"{column.vector}.{column.name} {column.unit}" for column in known)
    raise BadFileError(
        f"{place}: {quoted(name, MAX_SHOWN)} is no column of the emulator. {did_you_mean(f'{name} {unit}', names)}"
        f"Columns: {listing}."
    )


def seconds(
    times: Num[np.ndarray, " N"], column: Column, where: str, usual: str = ""
) -> tuple[Times, Column]:
    """Return the times since the first [s], and the column with the unit that they have.

    Without a unit, times less than a second apart are seconds, those that would be hours apart are in the only smaller unit
    that gives a usual rate, and others in the `usual` unit. BadFileError for times that cannot be in their unit, or that may
    be in several.
    """
    since = (times - times[:1]).astype(float)  # before rounding: whole numbers may be large
    interval = float(np.median(np.abs(np.diff(since)))) if len(since) > 1 else 0.0
    unit = column.unit or usual
    if not column.unit and interval < MAX_UNNAMED:
        unit = "s"
    if not column.unit and interval > MAX_STEP:
        likely = [name for name in SMALLER if FASTEST <= interval * TIME_UNITS[name] < MAX_UNNAMED]
        unit = likely[0] if len(likely) == 1 else ""
    factor = column.factor if column.unit else TIME_UNITS[unit]
    if not unit or interval * factor > MAX_STEP:
        raise BadFileError(
            f"{where}: times are {interval:.9g} apart; wanted seconds. Name their unit: time_s, time_ms, time_us or time_ns."
        )
    return since * factor, Column(TIME, TIME, unit, factor)


def samples_of(
    run: Shaped[np.ndarray, " N"],
    timing: tuple[Times, Column],
    resolution: Times,
    table: Float[np.ndarray, "N K"],
    columns: Sequence[Column],
    lines: Int[np.ndarray, " N"] | None = None,
) -> Samples:
    """Return samples in SI units; `table` has a column for each of `columns`, and `timing` is that of `seconds`.

    `resolution` is in the unit of the file's times.
    """
    time, clock = timing
    values = table * np.array([column.factor for column in columns])
    entries: dict[str, list[int]] = {vector: [] for vector in VECTORS}
    names: dict[str, list[tuple[str, str]]] = {vector: [] for vector in VECTORS}
    for number, column in enumerate(columns):
        entries[column.vector].append(number)
        names[column.vector].append((column.name, column.unit))
    changed = [column for column in (clock, *columns) if column.factor != 1]
    told = listed(f"{column.vector}.{column.name}".removeprefix("time.") for column in changed)
    return Samples(
        run=run,
        time=time,
        resolution=clock.factor * resolution,
        states=values[:, entries["state"]],
        controls=values[:, entries["control"]],
        state=tuple(names["state"]),
        control=tuple(names["control"]),
        lines=lines,
        remarks=(f"{told}: converted to SI units and radians",) if changed else (),
    )
