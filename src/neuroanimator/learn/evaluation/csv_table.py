"""Tables of measurements as CSV files: rows, quartiles, and the machines they were measured on."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neuroanimator.files.atomic import write_whole
from neuroanimator.learn.evaluation.machine import describe_machine

SEPARATOR = "; "
"""Between the descriptions of machines in the first line of a table."""


def quartiles(values: ArrayLike, digits: int = 3) -> str:
    """Return the quartiles of `values` (N,) to `digits` significant digits, such as `92.1-96.3`."""
    low, high = np.percentile(np.asarray(values), [25, 75])
    return f"{low:.{digits}g}-{high:.{digits}g}"


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows, the machine's description in the first line. A cell is empty where a row lacks its key."""
    _write(path, rows, [describe_machine()])


def merge_csv(
    path: Path,
    rows: list[dict[str, Any]],
    *columns: str,
    order: Callable[[dict[str, Any]], Any] | None = None,
) -> list[dict[str, Any]]:
    """Write `rows` in place of the table's rows with equal cells in `columns`; return all rows, sorted by `order` if given.

    The first line describes every machine on which rows that stay, or new ones, were measured.
    """
    renewed = {tuple(str(_cell(row[column])) for column in columns) for row in rows}
    kept = [
        row for row in read_rows(path) if tuple(row[column] for column in columns) not in renewed
    ]
    machines = _machines(path) if kept else []
    whole = [*kept, *rows]
    if order is not None:
        whole.sort(key=order)
    _write(path, whole, [*machines, describe_machine()])
    return whole


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table as they were written; none where there is no file."""
    if not path.exists():
        return []
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()[1:]))


def _machines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ").split(SEPARATOR)


def _write(path: Path, rows: list[dict[str, Any]], machines: list[str]) -> None:
    text = io.StringIO()
    text.write(f"# {SEPARATOR.join(dict.fromkeys(machines))}\n")
    columns = list(dict.fromkeys(key for row in rows for key in row))
    writer = csv.DictWriter(text, fieldnames=columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: _cell(value) for key, value in row.items()})
    write_whole(path, text.getvalue().encode())


def _cell(value: Any) -> Any:
    return f"{value:.5g}" if isinstance(value, float) else value
