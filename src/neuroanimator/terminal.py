"""Output for people: progress on stderr, as bars on a terminal or occasional lines elsewhere; plain tables on stdout."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from threading import Event, Thread, Timer, current_thread, main_thread
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from neuroanimator.text import print_line, printable

SHOWN_AFTER = 0.3
"""Minimum duration of a phase that is shown [s]: shorter ones would only flicker."""

QUIET_FOR = 1.0
"""Time without a line, and without a terminal, after which work that begins or goes on is mentioned [s]."""

LINE_EVERY = 10.0
"""Time between two lines on the same work without a terminal [s]."""


LOOK_EVERY = 0.1
"""Time between two looks, without a terminal, at whether a line is due [s]."""


Rows = list[tuple[str, object]]
"""Labels and values, as `print_rows` prints them."""

TableRows = list[dict[str, object]]
"""Rows of a table, as `print_table` prints them: values by the names of columns."""


class Bar:
    """A progress bar; does nothing if progress is not shown."""

    def __init__(
        self, progress: Display | None, title: str, total: int | None, *, is_visible: bool = True
    ):
        """`total` is None if the length is unknown."""
        self._progress = progress
        self._done = 0
        self._task: TaskID | None = None
        if progress is not None:
            self._task = progress.add_task(
                printable(title), total=total, note="", visible=is_visible
            )

    def advance_to(self, done: int, note: str = "") -> None:
        """Show `done` of the total, with a short note behind the bar."""
        self._done = done
        self._update(completed=done, note=printable(note))

    def advance(self) -> None:
        """Show that one more is done."""
        self.advance_to(self._done + 1)

    def show(self) -> None:
        """Make it visible."""
        self._update(visible=True)

    def _update(self, **shown: Any) -> None:
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, **shown)

    def end(self) -> None:
        """Stop the bar and leave it on the screen."""
        if self._progress is not None and self._task is not None:
            self._progress.stop_task(self._task)

    def remove(self) -> None:
        """Take it off the screen."""
        if self._progress is not None and self._task is not None:
            self._progress.remove_task(self._task)


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Bar]:
    """Show a bar of `total` units with rate and time left while the block runs.

    Without a terminal, a command prints a line of progress after `QUIET_FOR`, and then every `LINE_EVERY` seconds.
    """
    with _screen.shown() as progress:
        bar = Bar(progress, title, total)
        try:
            yield bar
        finally:
            bar.end()


@contextmanager
def inner_bar(title: str, total: int) -> Iterator[Bar]:
    """Show a bar of `total` units beside existing ones, if a command line runs (`show_phases`).

    It is shown while the block runs, and not at all for a quick block.
    """
    if not _screen.shows_phases:
        yield Bar(None, title, total)
        return
    with _screen.shown() as progress, _shown_soon(progress, title, total) as bar:
        yield bar


@contextmanager
def phase(name: str) -> Iterator[None]:
    """Show the phase `name` while the block runs, if a command line runs (`show_phases`).

    The time of each phase is in `phase_seconds`; that of a nested phase counts only once. Work of other threads is not a
    phase: the main thread waits for it in its own.
    """
    if current_thread() is not main_thread():
        yield
        return
    with _clock.running(name):
        if not _screen.shows_phases:
            yield
            return
        with _screen.shown() as progress, _shown_soon(progress, name, None):
            yield


def show_phases() -> None:
    """Show phases from now on, as the command line does, but a library does not."""
    _screen.shows_phases = True
    _screen.quiet_since = time.monotonic()


def tell(line: str) -> None:
    """Print `line` on stderr if a command line runs (`show_phases`)."""
    if _screen.shows_phases:
        print_line(f"neuroanimator: {line}", to_stderr=True)


def hide_progress() -> None:
    """Show neither phases nor bars from now on, as a server does."""
    _screen.is_hidden = True


def seconds_in_all() -> float:
    """Return the time since the first phase of this process began [s]."""
    return time.perf_counter() - _clock.began


def phase_seconds() -> dict[str, float]:
    """Return the time of each phase of this process [s], in the order of their starts."""
    return dict(_clock.seconds)


@contextmanager
def _shown_soon(progress: Display | None, title: str, total: int | None) -> Iterator[Bar]:
    """Show a bar of `total` units, or of unknown length, once the block has run for `SHOWN_AFTER`."""
    bar = Bar(progress, title, total, is_visible=False)
    timer = Timer(SHOWN_AFTER, bar.show)
    timer.daemon = True
    timer.start()
    try:
        yield bar
    finally:
        timer.cancel()
        timer.join()
        bar.remove()


class _Clock:
    """Time spent in every phase [s], without counting inner phases twice."""

    def __init__(self):
        self.seconds: dict[str, float] = {}
        self.began = time.perf_counter()
        self._within: list[float] = []
        """Time of the inner phases of every open phase [s]."""

    @contextmanager
    def running(self, name: str) -> Iterator[None]:
        """Count the time of the block for `name`."""
        if not self.seconds:
            self.began = time.perf_counter()
        self.seconds.setdefault(name, 0.0)
        self._within.append(0.0)
        began = time.perf_counter()
        try:
            yield
        finally:
            took = time.perf_counter() - began
            self.seconds[name] += took - self._within.pop()
            if self._within:
                self._within[-1] += took


class _PlainDisplay:
    """Bars and phases without a terminal: lines on the innermost one, the first after `QUIET_FOR` without any."""

    def __init__(self, screen: _Screen):
        self._screen = screen
        self._tasks: dict[TaskID, _PlainTask] = {}
        self._is_over = Event()
        self._thread = Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._is_over.set()
        self._thread.join()

    def add_task(
        self, description: str, *, total: float | None, note: str, visible: bool = True
    ) -> TaskID:
        task = TaskID(max(self._tasks, default=-1) + 1)
        self._tasks[task] = _PlainTask(description, total, note, visible)
        return task

    def update(
        self,
        task: TaskID,
        *,
        completed: float | None = None,
        note: str | None = None,
        visible: bool | None = None,
    ) -> None:
        shown = self._tasks[task]
        if completed is not None:
            shown.completed = completed
        if note is not None:
            shown.note = note
        if visible is not None:
            shown.is_visible = visible

    def stop_task(self, task: TaskID) -> None:
        del self._tasks[task]

    remove_task = stop_task

    def _run(self) -> None:
        screen = self._screen
        while not self._is_over.wait(LOOK_EVERY):
            shown = [task for task in list(self._tasks.values()) if task.is_visible]
            if not shown:
                continue
            innermost = shown[-1]
            is_known = innermost.description == screen.mentioned
            quiet = time.monotonic() - screen.quiet_since
            if quiet < (LINE_EVERY if is_known else QUIET_FOR):
                continue
            print_line(str(innermost), to_stderr=True)
            screen.mentioned = innermost.description
            screen.quiet_since = time.monotonic()


@dataclass
class _PlainTask:
    """A bar or a phase without a terminal."""

    description: str
    total: float | None
    """Total of a bar; None for a phase, whose length is unknown."""
    note: str
    is_visible: bool
    completed: float = 0.0
    began: float = field(default_factory=time.monotonic)
    """Time at which it began [s]."""

    def __str__(self) -> str:
        """Return its progress, and the estimated time left."""
        spent = time.monotonic() - self.began
        if self.total is None:
            return f"{self.description} ... {spent:.0f} s"
        told = f"{self.description}: {self.completed:,.0f} of {self.total:,.0f} after {spent:.0f} s"
        if self.completed:
            left = spent * (self.total / self.completed - 1)
            told += f", about {left:.0f} s left"
        return f"{told} ({self.note})" if self.note else told


Display = Progress | _PlainDisplay
"""Display of bars and phases."""


class _Screen:
    """The only live display of a process, with bars and phases as its lines."""

    def __init__(self):
        self.shows_phases = False
        self.is_hidden = False
        self.quiet_since = time.monotonic()
        """Time of the last line of progress, or of the command's beginning [s]."""
        self.mentioned = ""
        """Title of the work that this line was about."""
        self._progress: Display | None = None
        self._users = 0

    @contextmanager
    def shown(self) -> Iterator[Display | None]:
        """Yield the display, which lasts as long as it is used; None if progress is not shown."""
        is_terminal = sys.stderr is not None and sys.stderr.isatty()
        if self.is_hidden or not (is_terminal or self.shows_phases):
            yield None
            return
        if self._progress is None:
            self._progress = _new_display() if is_terminal else _PlainDisplay(self)
            self._progress.start()
        self._users += 1
        try:
            yield self._progress
        finally:
            self._users -= 1
            if self._users == 0:
                self._progress.stop()
                self._progress = None


class _Count(MofNCompleteColumn):
    """Progress as a count of the total; empty without a total."""

    def render(self, task: Task) -> Text:
        if task.total is None:
            return Text("")
        return super().render(task)


class _Remaining(TimeRemainingColumn):
    """Time left; empty if it is unknown."""

    def render(self, task: Task) -> Text:
        if task.total is None:
            return Text("")
        return super().render(task)


def _new_display() -> Progress:
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        _Count(),
        TimeElapsedColumn(),
        _Remaining(),
        TextColumn("{task.fields[note]}", markup=False),
        console=Console(stderr=True),
    )


_clock = _Clock()
_screen = _Screen()


def print_rows(rows: Iterable[tuple[str, object]]) -> None:
    """Print names and values in two columns."""
    rows = list(rows)
    width = max(len(printable(name)) for name, _ in rows)
    for name, value in rows:
        print(f"{printable(name):<{width}}  {printable(str(value))}")


def print_table(rows: list[dict[str, object]]) -> None:
    """Print rows of the same keys as aligned columns."""
    heads = [printable(head) for head in rows[0]]
    texts = []
    for row in rows:
        texts.append([_text(value) for value in row.values()])
    columns = zip(heads, *texts, strict=True)
    widths = [max(map(len, column)) for column in columns]
    for row in [heads, *texts]:
        cells = [f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)]
        print("  ".join(cells).rstrip())


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return printable(str(value))


BARS = "▁▂▃▄▅▆▇█"
"""Bars of a small histogram, from the lowest to the highest."""

PLAIN_BARS = ".:-=+*#@"
"""The same for a terminal without these characters."""


def sparkline(counts: Iterable[float]) -> str:
    """Return a histogram as one character per bar, the highest bar full; a blank for an empty bar."""
    counts = list(counts)
    bars = BARS if _can_print(BARS) else PLAIN_BARS
    most = max(counts, default=0)
    letters = []
    for count in counts:
        if count > 0:
            letters.append(bars[min(int(len(bars) * count / most), len(bars) - 1)])
        else:
            letters.append(" ")
    return "".join(letters)


def _can_print(text: str) -> bool:
    try:
        text.encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        return False
    return True


@cache
def warn_once(message: str) -> None:
    """Print a line on stderr, each only once."""
    print_line(f"neuroanimator: {message}", to_stderr=True)
