"""The verb `bench`: measure the project's figures on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from neuroanimator.cli.spread import Where, Workers, chosen_executor

EXAMPLE = "neuroanimator bench --table1 --quick"

TABLE_COLUMNS = (
    "system",
    "substeps",
    "one_step_error",
    "nominal_speedup",
    "nominal_1998",
    "equal_error_speedup",
    "equal_error_rival",
    "emulator_us",
    "rollout_error_1s",
    "rollout_error_5s",
    "break_even_hours",
    "diverged",
    "verdict",
)
"""These columns of the table of 1998 are printed; its CSV file has more."""

CONTROL_COLUMNS = (
    "task",
    "method",
    "success_rate",
    "iterations_median",
    "seconds_median",
    "cold_seconds",
    "j_physics_median",
    "speedup_over_best_rival",
    "best_rival",
    "gradient_cosine_median",
    "replan_p99_ms",
)
"""These columns of the table of controllers are printed; its CSV file has more."""

QUICK_SUBSTEPS = "50"
"""`--quick` measures emulators of this many physics steps a super step, written as on the command line."""


def run(
    table1: Annotated[
        bool, typer.Option("--table1", help="The table of 1998: every system, every n.")
    ] = False,
    control: Annotated[
        bool,
        typer.Option(
            "--control", help="Controllers by task, and their baselines on the true physics."
        ),
    ] = False,
    tasks: Annotated[
        str | None,
        typer.Option(help="Only these tasks of --control, such as fish-turn,truck-park."),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="n = 50, one seed, fewer runs and starts: minutes."),
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print rows as JSON.")] = False,
    systems: Annotated[
        str | None, typer.Option(help="Only these systems, such as truck,lander.")
    ] = None,
    substeps: Annotated[str | None, typer.Option(help="Only these n, such as 25,50.")] = None,
    seeds: Annotated[
        int, typer.Option(help="Training seeds; all but the first are trained, for hours.")
    ] = 1,
    out: Annotated[Path, typer.Option(help="Folder for table, plot and trainings.")] = Path(
        "out/bench"
    ),
    workers: Workers = None,
    executor: Where = "local",
) -> None:
    """Measure accuracy and speed of every system, print the table, write CSV and a work-precision plot."""
    from json import dumps

    from neuroanimator.bench.run_table import chosen_rows, run_table
    from neuroanimator.errors import ArgumentError
    from neuroanimator.terminal import print_rows, print_table

    if table1 == control:
        raise ArgumentError("bench: say what to measure: --table1 or --control.")
    if control:
        _run_control(tasks, quick, json, out)
        return
    if quick:
        substeps = substeps or QUICK_SUBSTEPS
        seeds = 1
    chosen = chosen_rows(systems, substeps or None)
    with chosen_executor(executor, workers) as spread:
        figures, files = run_table(chosen, out, is_quick=quick, seeds=seeds, executor=spread)
    if json:
        print(dumps(figures, indent=2))
        return
    print_table([{key: row[key] for key in TABLE_COLUMNS} for row in figures])
    print_rows([("file", path) for path in files])


def _run_control(tasks: str | None, quick: bool, json: bool, out: Path) -> None:
    from json import dumps

    from neuroanimator.bench.run_control import QUICK, THOROUGH, chosen_tasks, run_control_bench
    from neuroanimator.terminal import print_rows, print_table

    budget = QUICK if quick else THOROUGH
    rows, files = run_control_bench(chosen_tasks(tasks), out, budget)
    if json:
        print(dumps(rows, indent=2))
        return
    print_table([{key: row[key] for key in CONTROL_COLUMNS} for row in rows])
    print_rows([("file", path) for path in files])
