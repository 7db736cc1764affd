"""Progress of a descent: a progress bar for people, a line of JSON per iteration for programs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TextIO

from neuroanimator.errors import ResourceError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.terminal import progress_bar


@contextmanager
def watching(log: Path | None, iterations: int) -> Iterator[Callable[[int, float], None]]:
    """Yield an `on_iteration` for `descend` that shows a bar and writes the file `log` line by line.

    Iterations are numbered across all descents of a synthesis; `descent` is the number of the descent, as J may rise where
    the next one begins, with another emulator. `seconds` include compilation and replays.
    """
    began, done, descent = time.perf_counter(), 0, 0
    with progress_bar("iterations", iterations) as bar, _opened(log) as file:

        def on_iteration(iteration: int, cost: float) -> None:
            nonlocal done, descent
            done, descent = done + 1, descent + (iteration == 1)
            bar.advance_to(min(done, iterations), f"J {cost:.4g} after {done}")
            if file is not None:
                row = {
                    "descent": descent,
                    "iteration": done,
                    "J": cost if math.isfinite(cost) else None,
                }
                _write_line(
                    file, canonical_json(row | {"seconds": round(time.perf_counter() - began, 3)})
                )

        yield on_iteration


def _opened(log: Path | None) -> AbstractContextManager[TextIO | None]:
    if log is None:
        return nullcontext()
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        return open(log, "w", encoding="utf-8")
    except OSError as error:
        raise ResourceError(f"Could not write {log}: {error.strerror}.") from error


def _write_line(file: TextIO, line: str) -> None:
    try:
        file.write(line + "\n")
        file.flush()
    except OSError as error:
        raise ResourceError(f"Could not write {file.name}: {error.strerror}.") from error
