"""Tables of measurements as CSV files: rows, quartiles, and the machine they were measured on."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.files.atomic import write_whole


def quartiles(values: ArrayLike, digits: int = 3) -> str:
    """Return the quartiles of `values` (N,) to `digits` significant digits, such as `92.1-96.3`."""
    low, high = np.percentile(np.asarray(values), [25, 75])
    return f"{low:.{digits}g}-{high:.{digits}g}"


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows, the machine's description in the first line. A cell is empty where a row lacks its key."""
    text = io.StringIO()
    text.write(f"# {describe_machine()}\n")
    columns = list(dict.fromkeys(key for row in rows for key in row))
    writer = csv.DictWriter(text, fieldnames=columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: _cell(value) for key, value in row.items()})
    write_whole(path, text.getvalue().encode())


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table as they were written; none where there is no file."""
    if not path.exists():
        return []
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()[1:]))


def other_rows(path: Path, rows: list[dict[str, Any]], *columns: str) -> list[dict[str, Any]]:
    """Return the rows of the table at `path` that `rows` do not replace: those with other cells in `columns`."""
    renewed = {tuple(str(_cell(row[column])) for column in columns) for row in rows}
    return [
        row for row in read_rows(path) if tuple(row[column] for column in columns) not in renewed
    ]


def _cell(value: Any) -> Any:
    return f"{value:.5g}" if isinstance(value, float) else value
