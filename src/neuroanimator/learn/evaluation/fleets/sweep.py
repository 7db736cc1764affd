"""How to choose n: emulators of several super steps, trained on equal budgets and compared after equal time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.executor.executor import Executor
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.files.tables import check_table
from neuroanimator.learn.evaluation.fleets.fleet_file import (
    USUAL_SIZE,
    Fleet,
    FleetTable,
    members_of,
)
from neuroanimator.learn.evaluation.fleets.train_fleet import train_fleet
from neuroanimator.learn.evaluation.speed import measure_emulator


@dataclass(frozen=True)
class SweepRow:
    """One n of a sweep."""

    substeps: int
    one_step_error: float
    error: float
    """Rollout error after the requested time."""
    us_per_second: float
    """Time to emulate one second [µs]."""
    path: Path
    """The emulator's file."""


def sweep(
    reference: str,
    counts: Sequence[int],
    out: Path,
    *,
    seconds: float,
    transitions: int,
    updates: int,
    executor: Executor | None = None,
    on_row: Callable[[], None] = lambda: None,
) -> list[SweepRow]:
    """Return one row per n in `counts` for the system `reference` names; data and emulators are kept in `out`.

    They are a fleet: every n gets the same number of transitions and of updates. Errors are compared after `seconds` [s].
    The `executor` trains them; times are measured here, one after the other, while nothing else runs.
    """
    values = {
        "systems": [reference],
        "substeps": sorted(set(counts)),
        "sizes": {USUAL_SIZE: {"updates": updates}},
        "count": transitions,
        "seconds": seconds,
    }
    table: FleetTable = check_table(values, "sweep", FleetTable)
    members = members_of(reference, table, Path())
    fleet = Fleet(tuple(members), data="")
    trained = train_fleet(fleet, out, executor or LocalExecutor(1, core_count()), on_member=on_row)
    rows = []
    for member, row in zip(members, trained, strict=True):
        path = out / member.file_name
        emulator = Emulator.load(path)
        cost = measure_emulator(emulator) * 1e6 / emulator.dt
        rows.append(SweepRow(row.substeps, row.one_step_error, row.error, cost, path))
    return rows


def largest_within(rows: list[SweepRow], tolerance: float) -> SweepRow | None:
    """Return the row of the largest n whose error is at most `tolerance`, or None."""
    if not 0 < tolerance < float("inf"):
        raise ArgumentError(f"tolerance: wanted a positive number, got {tolerance:g}.")
    within = [row for row in rows if row.error <= tolerance]
    return max(within, key=lambda row: row.substeps, default=None)
