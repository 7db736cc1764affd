"""Tables of measurements as CSV files: rows, and the machines they were measured on."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neuroanimator.files.atomic import write_whole
from neuroanimator.learn.evaluation.machine import describe_machine

SEPARATOR = "; "
"""Between the descriptions of machines in the first line of a table."""


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


def cell_of(value: Any) -> Any:
    """Return what a table has of a value: five digits of a number."""
    return f"{value:.5g}" if isinstance(value, float) else value
