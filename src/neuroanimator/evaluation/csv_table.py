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
    """Return the quartiles of `values` (N,) with so many digits, such as `92.1-96.3`."""
    low, high = np.percentile(np.asarray(values), [25, 75])
    return f"{low:.{digits}g}-{high:.{digits}g}"


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows of the same keys, the machine's description in the first line."""
    text = io.StringIO()
    text.write(f"# {describe_machine()}\n")
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: _cell(value) for key, value in row.items()})
    write_whole(path, text.getvalue().encode())


def _cell(value: Any) -> Any:
    return f"{value:.5g}" if isinstance(value, float) else value
