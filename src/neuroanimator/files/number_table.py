"""Tables of numbers as text, whichever program wrote them: a header, then a row of numbers for each line below it.

Cells are separated by commas, semicolons or tabs. What a comma and a point within a number mean is decided for the whole
file, since a single cell cannot tell: 1,234 may be a thousand or a little more than one.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import one_line
from neuroanimator.files.numbers import MAX_MAGNITUDE, number_in
from neuroanimator.files.text_lines import text_lines
from neuroanimator.text import quoted

DELIMITERS = (",", ";", "\t")
"""Separators of cells: the first of these that gives the wanted header is used."""

REMARK = "#"
"""Prefix of remarks: lines before the header that begin with it, and empty ones, are skipped."""

MAX_REMARKS = 1000
"""Maximum number of skipped lines, so that a file of only line breaks is refused at once."""

MAX_SHOWN = 40
"""Maximum number of characters of a wrong cell shown in an error."""

MARKS = ".,"
"""Characters that may be the decimal mark, or else separate thousands."""

SPACES = " \u00a0\u202f'\u2019"
"""Characters that separate thousands and nothing else."""

MAX_PLACE = 300
"""Maximum magnitude of a power of ten: that of double precision."""

EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
"""Pattern of numbers whose mark may be either."""


class Header(NamedTuple):
    """The first line of a table that is neither empty nor a remark."""

    cells: list[str]
    line: int
    """Its number; 0 if there is none."""
    delimiter: str


class Notation(NamedTuple):
    """The meaning of commas and points in the numbers of a file."""

    decimal: str = "."
    thousands: str = ","

    def plain(self, cell: str) -> str:
        """Return a number as Python writes it; no number at all if the cell does not follow the notation."""
        text = cell.strip()
        if text.isascii() and self.thousands not in text and " " not in text and "'" not in text:
            return text.replace(self.decimal, ".")
        groups = (
            rf"[+-]?\d{{1,3}}([{self.thousands}{SPACES}])\d{{3}}(\1\d{{3}})*(\{self.decimal}\d*)?"
        )
        found = re.fullmatch(groups, text)
        if found is None:
            return ""
        return text.replace(found[1], "").replace(self.decimal, ".")


@dataclass(frozen=True)
class NumberTable:
    """The numbers of some columns of a table, row by row."""

    values: Float[np.ndarray, "N K"]
    lines: Int[np.ndarray, " N"]
    """Line number of each row."""
    places: Int[np.ndarray, " N"]
    """Power of ten of the last digit that is written of the first number in each row."""
    labels: Int[np.ndarray, " N"]
    """Number of each row's label, in order of appearance; 0 without labels."""


def read_header(content: bytes, is_header: Callable[[list[str]], bool], file: str) -> Header:
    """Return the header, with cells separated so that `is_header` holds, by commas if none do; BadFileError names the line."""
    try:
        headers = [_first(content, delimiter) for delimiter in DELIMITERS]
    except ValueError as error:
        raise BadFileError(f"{file}, {one_line(error)}.") from error
    for header in headers:
        if is_header(header.cells):
            return header
    return headers[0]


def _first(content: bytes, delimiter: str) -> Header:
    line = 0
    for line, cells in islice(csv_rows(content, delimiter), MAX_REMARKS):
        if cells and not cells[0].startswith(REMARK):
            return Header(cells, line, delimiter)
    return Header([], line, delimiter)


def read_numbers(
    content: bytes, header: Header, columns: Sequence[int], file: str, label: int | None = None
) -> NumberTable:
    """Return the numbers in `columns` of the table in `content`, and which rows have equal texts in the column `label`.

    Empty lines are skipped. BadFileError names line and column of the first cell that holds no finite number.
    """
    labels: dict[str, int] = {}
    # Typed arrays: Python's lists would take five times the memory.
    numbers = array("d")
    lines = array("q")
    places = array("q")
    groups = array("q")
    try:
        notation = _notation(content, header, columns, file)
        for line, cells in _rows(content, header, file):
            texts = [notation.plain(cells[column]) for column in columns]
            for column, text in zip(columns, texts, strict=True):
                try:
                    value = number_in(text)
                except ValueError:
                    value = math.nan
                if not abs(value) < MAX_MAGNITUDE:  # True for NaN
                    raise BadFileError(
                        f"{file}, line {line}, column {column + 1} ({header.cells[column]}): wanted a finite number, "
                        f"got {quoted(cells[column], MAX_SHOWN)}. Fill it in, or leave the row out."
                    )
                numbers.append(value)
            lines.append(line)
            places.append(last_place(texts[0]))
            text = "" if label is None else cells[label].strip()
            groups.append(labels.setdefault(text, len(labels)))
    except ValueError as error:
        raise BadFileError(f"{file}, {one_line(error)}.") from error
    return NumberTable(
        values=np.array(numbers).reshape(-1, len(columns)),
        lines=np.array(lines, int),
        places=np.array(places, int),
        labels=np.array(groups, int),
    )


def _rows(content: bytes, header: Header, file: str) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, cells) of the rows below the header; BadFileError for a row of another length."""
    for line, cells in islice(csv_rows(content, header.delimiter), header.line, None):
        if cells and len(cells) != len(header.cells):
            raise BadFileError(
                f"{file}, line {line}: {len(cells)} cells; wanted {len(header.cells)}, as in the header. Correct the row."
            )
        if cells:
            yield line, cells


def last_place(text: str) -> int:
    """Return the power of ten of the last digit in a plain number: -3 for 0.250, 2 for 1e2."""
    mantissa, _, exponent = text.lower().partition("e")
    place = int(exponent or 0) - len(mantissa.partition(".")[2])
    return min(max(place, -MAX_PLACE), MAX_PLACE)


def _notation(content: bytes, header: Header, columns: Sequence[int], file: str) -> Notation:
    """Return the meaning of commas and points in the numbers of the file.

    Raises BadFileError naming the lines of numbers that contradict each other, or of one that leaves it open.
    """
    has_commas = b'"' in content if header.delimiter == "," else b"," in content
    if not has_commas:
        return Notation()
    seen = _marks(content, header, columns, file)
    for mark, other in (MARKS, MARKS[::-1]):
        against = seen.thousands.get(mark) or seen.decimal.get(other)
        if mark in seen.decimal and against:
            raise BadFileError(
                f"{file}: numbers contradict each other: {seen.decimal[mark]} and {against}. Write all with the same decimal "
                "mark."
            )
        if mark in seen.decimal or other in seen.thousands:
            return Notation(mark, other)
    if "," in seen.either:
        raise BadFileError(
            f"{file}: {seen.either[',']} may be a thousand times as large. Write numbers without separators of thousands."
        )
    return Notation()


class _Marks(NamedTuple):
    """The first cell in which each mark occurs in a role, with its line."""

    decimal: dict[str, str]
    thousands: dict[str, str]
    either: dict[str, str]


def _marks(content: bytes, header: Header, columns: Sequence[int], file: str) -> _Marks:
    """Return what the commas and points in the numbers of the file can be, each number by itself."""
    seen = _Marks({}, {}, {})
    for line, cells in _rows(content, header, file):
        for column in columns:
            cell = cells[column].strip()
            marks = [letter for letter in cell if letter in MARKS]
            if not marks:
                continue
            place = f"{quoted(cell, MAX_SHOWN)} in line {line}"
            role = seen.decimal
            if EITHER.fullmatch(cell):
                role = seen.either
            elif marks.count(marks[-1]) > 1:
                role = seen.thousands
            role.setdefault(marks[-1], place)
            if marks[0] != marks[-1]:
                seen.thousands.setdefault(marks[0], place)
    return seen


def csv_rows(content: bytes, delimiter: str = ",") -> Iterator[tuple[int, list[str]]]:
    """Yield (line number from 1, cells) of every line of `content`, in UTF-8; a line without text has no cells.

    Raises ValueError naming the line. A cell cannot continue in the next line.
    """
    for number, line in text_lines(content):
        try:
            yield number, _cells(line, delimiter)
        except csv.Error as error:
            raise ValueError(f"line {number}: {error}") from error


def _cells(line: str, delimiter: str) -> list[str]:
    if not line.strip():
        return []
    return next(csv.reader([line], delimiter=delimiter), [])
