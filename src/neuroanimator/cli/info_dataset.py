"""What `info` says of a dataset's folder: what it is made of, what it covers, and which runs were left out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from neuroanimator.data.coverage import Coverage, Spread
    from neuroanimator.storage.places import Place

MAX_SPREADS = 40
"""So many numbers of states or controls are shown, a line each; of the others only how many there are."""

COVERAGE_WORDS = (
    "5 %, 95 %: one sample in twenty lies below, above. Histograms go from the state's 0.5 % to its 99.5 %, of controls "
    "from bound to bound."
)
"""What the table's columns mean."""


def show_dataset(folder: Place, *, json: bool) -> None:
    """Print what there is to say of the dataset in `folder`: as a table, or all of it as JSON."""
    from json import dumps

    from neuroanimator.data.store import read_config
    from neuroanimator.terminal import phase, print_rows
    from neuroanimator.text import print_line

    config = read_config(folder)
    present = sum(config.shard_path(folder, shard).is_file() for shard in range(config.shards))
    found = None
    if present:
        with phase("reading"):
            from neuroanimator.data.coverage import coverage

            found = coverage(folder)
    if json:
        everything: dict[str, Any] = config.model_dump()
        everything["coverage"] = found.to_json() if found else None
        print(dumps(everything, indent=2, sort_keys=True))
        return
    rows: list[tuple[str, object]] = [
        ("dataset", folder),
        ("system", config.system),
        ("super step", f"{config.substeps} physics steps"),
        ("transitions", f"{config.count:,} asked for, seed {config.seed}"),
        ("shards", f"{present} of {config.shards} made"),
        ("MuJoCo", config.mujoco),
        ("config", config.hash),
    ]
    if found:
        rows += coverage_rows(found)
    if not found or found.missing:
        rows.append(("to be done", "run the same 'generate' again: it goes on where it stopped"))
    print_rows(rows)
    if found:
        print()
        print_spreads(found)
        print_line(COVERAGE_WORDS)


def coverage_rows(found: Coverage) -> list[tuple[str, object]]:
    """Return what is said of the runs: how many there are, which were dropped, and what to do about it."""
    there = f"{found.transitions:,} transitions of {found.runs:,} runs"
    if found.samples < found.transitions:
        there += f"; {found.samples:,} of them looked at"
    rows: list[tuple[str, object]] = [("there are", there)]
    diverged = found.diverged
    if not diverged.runs:
        rows.append(("diverged", "no run"))
    else:
        rows.append(("diverged", f"{diverged.runs:,} runs, dropped: {diverged.share:.2g} of all"))
        rows += [("", condition) for condition in diverged.conditions]
        rows.append(("what to do", diverged.advice))
    if found.missing:
        rows.append(
            ("missing or damaged", f"{len(found.missing)} shards, such as {found.missing[0]}")
        )
    return rows


def print_spreads(found: Coverage) -> None:
    """Print a line for each number of states and controls: its quantiles, its histogram, how often it is at a bound."""
    _print_table("state", found.states)
    if found.controls:
        print()
        _print_table("control", found.controls)


def _print_table(kind: str, spreads: Sequence[Spread]) -> None:
    from neuroanimator.terminal import print_table
    from neuroanimator.text import print_line

    print_table([spread_row(kind, spread) for spread in spreads[:MAX_SPREADS]])
    left_out = len(spreads) - MAX_SPREADS
    if left_out > 0:
        print_line(f"and {left_out} more (--json names them)")


def spread_row(kind: str, spread: Spread) -> dict[str, object]:
    """Return the columns of one number of a state or control, `kind`."""
    from neuroanimator.terminal import sparkline

    unit = "" if spread.unit == "1" else f" {spread.unit}"
    least, low, median, high, most = spread.tidy
    row: dict[str, object] = {
        kind: f"{spread.name}{unit}",
        "least": least,
        "5 %": low,
        "median": median,
        "95 %": high,
        "most": most,
        "histogram": sparkline(spread.counts.tolist()),
    }
    if spread.at_bounds is not None:
        row["at a bound"] = f"{spread.at_bounds:.1%}"
    return row
