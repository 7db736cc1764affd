"""What all benchmarks share: where things lie, their options, clocks, and tables with the machine's description.

Two sides are timed in turn by `neuroanimator.learn.evaluation.speed.interleaved`.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neuroanimator.learn.evaluation.csv_table import SEPARATOR, cell_of, write_csv
from neuroanimator.learn.evaluation.machine import describe_machine
from neuroanimator.terminal import print_table

Rows = list[dict[str, Any]]

ROOT = Path(__file__).resolve().parents[1]

HUMAN = ROOT / "examples" / "human"
"""The human's model, motions and policies."""

IMAGES = ROOT / "docs" / "images"

PROGRAM = Path(sys.executable).with_name("neuroanimator")
"""The command, as users type it."""


def parser_of(text: str | None, *, quick: str = "") -> argparse.ArgumentParser:
    """Return a parser whose help is a script's own `text`, with --dry, and with --quick where `quick` says what that is."""
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--dry", action="store_true", help="write no table")
    if quick:
        parser.add_argument("--quick", action="store_true", help=f"{quick}; writes no table")
    return parser


def show_rows(rows: Rows, *columns: str) -> None:
    """Print rows as a table, or only some of their columns; before the first one the machine's description."""
    _show_machine()
    if columns:
        rows = [{key: row[key] for key in columns} for row in rows]
    print_table(rows)


def keep_rows(
    table: Path,
    rows: Rows,
    options: argparse.Namespace,
    *columns: str,
    order: Callable[[dict[str, Any]], Any] | None = None,
) -> None:
    """Write rows as a table, unless this is a try; with `columns` in place of its rows with equal cells in them."""
    if options.dry or getattr(options, "quick", False):
        return
    if columns:
        merge_csv(table, rows, *columns, order=order)
    else:
        write_csv(table, rows)


def merge_csv(
    path: Path,
    rows: Rows,
    *columns: str,
    order: Callable[[dict[str, Any]], Any] | None = None,
) -> Rows:
    """Write `rows` in place of the table's rows with equal cells in `columns`; return all rows, sorted by `order` if given.

    The first line describes every machine on which rows that stay, or new ones, were measured.
    """
    renewed = {tuple(str(cell_of(row[column])) for column in columns) for row in rows}
    kept = [
        row for row in read_rows(path) if tuple(row[column] for column in columns) not in renewed
    ]
    machines = []
    if kept:
        head = path.read_text(encoding="utf-8").splitlines()[0]
        machines = head.removeprefix("# ").split(SEPARATOR)
    whole = [*kept, *rows]
    if order is not None:
        whole.sort(key=order)
    write_csv(path, whole, machines)
    return whole


@cache
def _show_machine() -> None:
    print(describe_machine())


class Clocks(NamedTuple):
    """Times that have passed since some moment."""

    seconds: float
    """Wall time [s]."""
    cpu_seconds: float
    """CPU time of all threads, and of child processes that have ended [s]."""

    @classmethod
    def now(cls) -> Clocks:
        """Return what the clocks show."""
        ended = os.times()
        cpu_seconds = time.process_time() + ended.children_user + ended.children_system
        return cls(time.perf_counter(), cpu_seconds)

    def passed(self) -> Clocks:
        """Return the times since these clocks were read."""
        now = Clocks.now()
        return Clocks(now.seconds - self.seconds, now.cpu_seconds - self.cpu_seconds)

    def plus(self, other: Clocks) -> Clocks:
        """Return the times of both."""
        return Clocks(self.seconds + other.seconds, self.cpu_seconds + other.cpu_seconds)


def seconds_of(function: Callable[[], Any], rounds: int) -> list[float]:
    """Return how long each of `rounds` calls takes [s]."""
    spans = []
    for _ in range(rounds):
        began = time.perf_counter()
        function()
        spans.append(time.perf_counter() - began)
    return spans


def quartiles(values: ArrayLike, digits: int = 3) -> str:
    """Return the quartiles of `values` (N,) to `digits` significant digits, such as `92.1-96.3`."""
    low, high = np.percentile(np.asarray(values), [25, 75])
    return f"{low:.{digits}g}-{high:.{digits}g}"


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table as they were written; none where there is no file."""
    if not path.exists():
        return []
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()[1:]))
