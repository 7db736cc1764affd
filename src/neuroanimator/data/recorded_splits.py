"""Which samples of recordings are learnt from and which are kept for the test: disjoint stretches of runs."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from neuroanimator.errors import BadFileError
from neuroanimator.systems.recorded.recorded_system import RecordedSystem

WANTED_STRETCHES = 40
"""Long runs are cut until there are about so many: training keeps whole stretches to validate on."""

FEWEST_STRETCHES = 3
"""One to learn from, one to validate on, one to test on."""

TEST_EVERY = 10
"""Every tenth stretch is kept for the test, and at least the last."""

ROOM = 3
"""A stretch is at least so many windows long: cutting loses one."""


class Stretch(NamedTuple):
    """Consecutive samples of one run."""

    run: int
    start: int
    stop: int

    def windows(self, length: int) -> int:
        """Return at how many offsets a window of `length` samples fits."""
        return self.stop - self.start - length + 1


def cut_stretches(system: RecordedSystem, length: int) -> tuple[list[Stretch], list[Stretch]]:
    """Return (stretches to learn from, stretches for the test), each at least `length` samples long."""
    for rows, origin in zip(system.rows, system.origins, strict=True):
        if rows < length:
            raise BadFileError(
                f"{system.file}, {origin}: a run of {rows} rows; wanted at least {length} for so long a super step. "
                "Use a smaller --substeps, or leave the run out."
            )
    found = [
        stretch for run in range(len(system.rows)) for stretch in _cut_run(system, run, length)
    ]
    if len(found) < FEWEST_STRETCHES:
        raise BadFileError(
            f"{system.file}: {sum(system.rows)} rows are too few to learn from and to test on; "
            f"wanted at least {FEWEST_STRETCHES * ROOM * length}. Record longer, or use a smaller --substeps."
        )
    test = set(found[TEST_EVERY - 1 :: TEST_EVERY] or found[-1:])
    return [stretch for stretch in found if stretch not in test], sorted(test)


def _cut_run(system: RecordedSystem, run: int, length: int) -> list[Stretch]:
    rows = system.rows[run]
    wanted = round(WANTED_STRETCHES * rows / sum(system.rows))
    parts = max(1, min(wanted, rows // (ROOM * length)))
    edges = [rows * part // parts for part in range(parts + 1)]
    return [Stretch(run, start, stop) for start, stop in pairwise(edges)]
