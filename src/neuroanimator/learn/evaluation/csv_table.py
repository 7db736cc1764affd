"""Tables of measurements as CSV files: rows, quartiles, and the machines they were measured on."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
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


def write_csv(path: Path, rows: list[dict[str, Any]], machines: Sequence[str] = ()) -> None:
    """Write rows; in the first line describe the `machines` of some of them, and this one. Cells without a value are empty."""
    text = io.StringIO()
    text.write(f"# {SEPARATOR.join(dict.fromkeys([*machines, describe_machine()]))}\n")
    columns = list(dict.fromkeys(key for row in rows for key in row))
    writer = csv.DictWriter(text, fieldnames=columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: cell_of(value) for key, value in row.items()})
    write_whole(path, text.getvalue().encode())


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table as they were written; none where there is no file."""
    if not path.exists():
        return []
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()[1:]))


def cell_of(value: Any) -> Any:
    """Return what a table has of a value: five digits of a number."""
    return f"{value:.5g}" if isinstance(value, float) else value
