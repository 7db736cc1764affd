"""Output of `info` and `evaluate`: the coverage of a dataset, and the weak spots of an emulator."""

from __future__ import annotations

from json import dumps
from typing import Any

from neuroanimator.files.places import Place
from neuroanimator.learn.data.store import read_config
from neuroanimator.learn.evaluation.weakness.coverage import coverage
from neuroanimator.learn.evaluation.weakness.inspection import Inspection
from neuroanimator.learn.evaluation.weakness.tables import (
    COMPONENTS_CAPTION,
    COVERAGE_CAPTION,
    CellTable,
    component_table,
    coverage_facts,
    spread_tables,
)
from neuroanimator.terminal import Rows, phase, print_rows, print_table, sparkline
from neuroanimator.text import print_line, short_number


def show_dataset(folder: Place, *, json: bool) -> None:
    """Print what the dataset in `folder` is and what it covers, as tables or as JSON."""
    config = read_config(folder)
    present = sum(config.shard_path(folder, shard).is_file() for shard in range(config.shards))
    found = None
    if present:
        with phase("reading"):
            found = coverage(folder)
    if json:
        everything: dict[str, Any] = config.model_dump()
        everything["coverage"] = found.to_json() if found else None
        print(dumps(everything, indent=2, sort_keys=True))
        return

    rows: Rows = [
        ("dataset", folder),
        ("system", config.system),
        ("super step", f"{config.substeps} physics steps"),
        ("transitions", f"{config.count:,} asked for, seed {config.seed}"),
        ("shards", f"{present} of {config.shards} made"),
        ("MuJoCo", config.mujoco),
        ("config", config.hash),
    ]
    if found:
        rows += coverage_facts(found)
    if not found or found.missing:
        rows.append(("remaining", "run the same 'generate' again: it resumes where it stopped"))
    print_rows(rows)
    if found:
        for table in spread_tables(found, sparkline):
            print()
            _print(table)
        print_line(COVERAGE_CAPTION)


def print_weak_spots(found: Inspection) -> None:
    """Print the distribution of one-step errors, and a line for each condition under which they are large."""
    errors = found.errors
    print_line(f"{found.system}: {errors}.")
    print_line(
        f"{found.system}: how often, from {short_number(errors.edges[0])} to {short_number(errors.edges[-1])} "
        f"(logarithmic): |{sparkline(errors.counts.tolist())}|"
    )
    for spot in found.weak_spots:
        print_line(f"{found.system}: {spot}")
    if found.outside.samples:
        print_line(f"{found.system}: {found.outside}")


def print_components(found: Inspection) -> None:
    """Print the one-step error of each state entry, the worst first."""
    _print(component_table(found))
    print_line(COMPONENTS_CAPTION)


def _print(table: CellTable) -> None:
    """Print a table and its remarks."""
    print_table(table.rows)
    for remark in table.remarks:
        print_line(remark)
