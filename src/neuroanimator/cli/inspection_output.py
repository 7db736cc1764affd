"""Output of `info` and `evaluate`: the coverage of a dataset, and where an emulator is weak."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from neuroanimator.evaluation.weakness.inspection import Inspection
    from neuroanimator.evaluation.weakness.tables import Table
    from neuroanimator.storage.places import Place


def show_dataset(folder: Place, *, json: bool) -> None:
    """Print what the dataset in `folder` is and what it covers: as tables, or all of it as JSON."""
    from json import dumps

    from neuroanimator.data.store import read_config
    from neuroanimator.terminal import phase, print_rows, sparkline
    from neuroanimator.text import print_line

    config = read_config(folder)
    present = sum(config.shard_path(folder, shard).is_file() for shard in range(config.shards))
    found = None
    if present:
        with phase("reading"):
            from neuroanimator.evaluation.weakness.coverage import coverage

            found = coverage(folder)
    if json:
        everything: dict[str, Any] = config.model_dump()
        everything["coverage"] = found.to_json() if found else None
        print(dumps(everything, indent=2, sort_keys=True))
        return
    from neuroanimator.evaluation.weakness.tables import (
        COVERAGE_CAPTION,
        coverage_facts,
        spread_tables,
    )

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
        rows += coverage_facts(found)
    if not found or found.missing:
        rows.append(("to be done", "run the same 'generate' again: it goes on where it stopped"))
    print_rows(rows)
    if found:
        for table in spread_tables(found, sparkline):
            print()
            _print(table)
        print_line(COVERAGE_CAPTION)


def print_weak_spots(found: Inspection) -> None:
    """Print how the one-step errors are spread, and a line for each condition under which they are large."""
    from neuroanimator.terminal import sparkline
    from neuroanimator.text import print_line, short_number

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
    """Print the one-step error of each number of the state, the worst first."""
    from neuroanimator.evaluation.weakness.tables import COMPONENTS_CAPTION, component_table
    from neuroanimator.text import print_line

    _print(component_table(found))
    print_line(COMPONENTS_CAPTION)


def _print(table: Table) -> None:
    """Print a table and its remarks."""
    from neuroanimator.terminal import print_table
    from neuroanimator.text import print_line

    print_table(table.rows)
    for remark in table.remarks:
        print_line(remark)
