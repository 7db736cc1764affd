"""Lines of comma-separated text from strangers, one at a time and of bounded length."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

MAX_LINE = 128 * 1024
"""Maximum number of characters in a line: a thousand columns at full precision take a fifth of it."""


def csv_rows(content: bytes, delimiter: str = ",") -> Iterator[tuple[int, list[str]]]:
    """Yield (line number from 1, cells) of every line of `content`, in UTF-8; a line without text has no cells.

    Raises ValueError naming the line. A cell cannot continue in the next line.
    """
    text = io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig", newline=None)
    number = 0
    try:
        while line := text.readline(MAX_LINE + 1):
            number += 1
            if len(line) > MAX_LINE:
                raise ValueError(f"more than {MAX_LINE:,} characters in a line")
            yield number, _cells(line.rstrip("\n"), delimiter)
    except UnicodeDecodeError as error:
        raise ValueError(
            f"after line {number}: not text in UTF-8 ({error.reason}). Save it as CSV in UTF-8"
        ) from error
    except (ValueError, csv.Error) as error:
        raise ValueError(f"line {number}: {error}") from error


def _cells(line: str, delimiter: str) -> list[str]:
    if not line.strip():
        return []
    return next(csv.reader([line], delimiter=delimiter), [])
