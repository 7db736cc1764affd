"""What people see: progress bars on stderr, and only on a terminal; plain tables on stdout."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from neuroanimator.text import print_line, printable


class Bar:
    """One bar; does nothing where there is no terminal."""

    def __init__(self, progress: Progress | None, title: str, total: int):
        self._progress = progress
        self._task = progress.add_task(printable(title), total=total, note="") if progress else None

    def advance_to(self, done: int, note: str = "") -> None:
        """Show `done` of the total, with a short note behind the bar."""
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, completed=done, note=printable(note))


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Bar]:
    """Show a bar of `total` units with rate and time left while the block runs."""
    if not sys.stderr.isatty():
        yield Bar(None, title, total)
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        yield Bar(progress, title, total)


def print_rows(rows: Iterable[tuple[str, object]]) -> None:
    """Print names and values in two columns."""
    rows = list(rows)
    width = max(len(printable(name)) for name, _ in rows)
    for name, value in rows:
        print(f"{printable(name):<{width}}  {printable(str(value))}")


def print_table(rows: list[dict[str, object]]) -> None:
    """Print rows of the same keys as aligned columns."""
    texts = [[_text(value) for value in row.values()] for row in rows]
    heads = [printable(head) for head in rows[0]]
    widths = [max(len(head), *(len(row[i]) for row in texts)) for i, head in enumerate(heads)]
    for row in [heads, *texts]:
        print("  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else printable(str(value))


@cache
def warn_once(message: str) -> None:
    """Print one line on stderr; the same one never again."""
    print_line(f"neuroanimator: {message}", to_stderr=True)
