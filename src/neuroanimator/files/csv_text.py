"""Lines of comma-separated text from strangers."""

from __future__ import annotations

import csv
from collections.abc import Iterator

from neuroanimator.files.text_lines import text_lines


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
