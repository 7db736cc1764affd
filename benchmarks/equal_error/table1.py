"""Table 1 of the paper: accuracy and speed of every emulator that ships, against physics in C.

python -m benchmarks.equal_error.table1                                          every row, and table1.csv
python -m benchmarks.equal_error.table1 --quick                                  n = 50, fewer runs: minutes; writes no file
python -m benchmarks.equal_error.table1 --quick --substeps 25,50,100,200 --keep  all of them, ten minutes; writes table1.csv
python -m benchmarks.equal_error.table1 --systems fish --substeps 25             these rows alone; the others in table1.csv stay
python -m benchmarks.equal_error.table1 --quick --json                           rows as JSON
python -m benchmarks.equal_error.table1 --seeds 5                                four further trainings per row: hours

Emulators of machines at n = 200 do not ship: they are trained in out/table1 by the recipes of those that do.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.equal_error.chunk_time import time_chunk
from benchmarks.equal_error.paper_table import TableRow, measure_row
from benchmarks.equal_error.work_precision import draw_work_precision
from benchmarks.harness import keep_rows, parser_of, show_rows
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError, NeuroAnimatorError
from neuroanimator.files.zoo import SHIPPED, emulator_name
from neuroanimator.learn.evaluation.evaluate import QUICK, THOROUGH, EvaluationBudget
from neuroanimator.learn.training.recipes import RECIPES
from neuroanimator.terminal import progress_bar
from tools.cook import cook

Choice = list[tuple[str, int]]
"""Pairs of a system and its n, the physics steps of a super step."""

PRINTED = (
    "system",
    "substeps",
    "one_step_error",
    "nominal_speedup",
    "nominal_1998",
    "equal_error_speedup",
    "equal_error_baseline",
    "emulator_us",
    "rollout_error_1s",
    "rollout_error_5s",
    "break_even_hours",
    "diverged",
    "verdict",
)
"""Columns that are printed; the CSV file has more."""

LONG = [(system, 200) for system in ("pendulum-passive", "pendulum", "truck")]
"""Pairs of a system whose control can be held for 0.2 or 0.4 s and that n; their emulators do not ship."""

ROWS = sorted([*SHIPPED, *LONG])
"""Pairs of a system and n of every row."""

QUICK_SUBSTEPS = "50"
"""Physics steps a super step of the emulators that `--quick` measures, as on the command line."""

TRAININGS = Path("out/table1")
"""Folder of trainings with further seeds, and of those whose emulators do not ship."""

TABLE = Path(__file__).with_name("table1.csv")


def chosen_rows(systems: str | None, substeps: str | None) -> Choice:
    """Return the (system, n) pairs that comma-separated names and numbers leave; all of them without."""
    known_systems = {system for system, _ in ROWS}
    known_substeps = {str(n) for _, n in ROWS}
    names = set(systems.split(",")) if systems else known_systems
    counts = set(substeps.split(",")) if substeps else known_substeps
    chosen = [(system, n) for system, n in ROWS if system in names and str(n) in counts]
    unknown = (names - known_systems) | (counts - known_substeps)
    if unknown or not chosen:
        valid = ", ".join(emulator_name(*row) for row in ROWS)
        raise ArgumentError(f"No rows for {', '.join(sorted(unknown))}. Rows: {valid}.")
    return chosen


def measure_rows(chosen: Choice, budget: EvaluationBudget, seeds: int) -> list[TableRow]:
    """Return a row per pair; emulators of further training seeds are trained in `TRAININGS` and kept there."""
    rows = []
    chunk_seconds: dict[str, float] = {}
    with progress_bar("rows", len(chosen)) as bar:
        for system, n in chosen:
            bar.advance_to(len(rows), emulator_name(system, n))
            emulators = []
            for seed in range(seeds):
                if seed == 0 and (system, n) in SHIPPED:
                    emulators.append(Emulator.load(emulator_name(system, n)))
                    continue
                emulator, _ = cook(system, n, TRAININGS, seed=seed)
                emulators.append(emulator)
            if system not in chunk_seconds:
                recipe = RECIPES[system]
                config = recipe.training(recipe.stride(n))
                chunk_seconds[system] = time_chunk(emulators[0], config)
            rows.append(measure_row(emulators, chunk_seconds[system], budget))
    return rows


def main(arguments: list[str] | None = None) -> None:
    parser = parser_of(__doc__, quick="n = 50, one seed, fewer runs")
    parser.add_argument("--systems", help="only these systems, such as truck,lander")
    parser.add_argument("--substeps", help="only these n, such as 25,50")
    parser.add_argument("--seeds", type=int, default=1, help="training seeds; all but one train")
    parser.add_argument("--plot", type=Path, help="also draw work against precision, as a PNG")
    parser.add_argument("--keep", action="store_true", help="renew these rows of table1.csv")
    parser.add_argument("--json", action="store_true", help="print all columns as JSON")
    options = parser.parse_args(arguments)
    substeps = options.substeps
    if options.quick:
        substeps = substeps or QUICK_SUBSTEPS
    chosen = chosen_rows(options.systems, substeps)
    budget = QUICK if options.quick else THOROUGH
    rows = measure_rows(chosen, budget, options.seeds)
    figures = [row.figures for row in rows]
    options.quick &= not options.keep
    keep_rows(TABLE, figures, options, "system", "substeps", order=_place)
    if options.plot:
        evaluations = [evaluation for row in rows for evaluation in row.evaluations]
        draw_work_precision(evaluations, options.plot)
    if options.json:
        print(json.dumps(figures, indent=2))
    else:
        show_rows(figures, *PRINTED)


def _place(row: dict[str, Any]) -> tuple[str, int]:
    return row["system"], int(row["substeps"])


if __name__ == "__main__":
    try:
        main()
    except NeuroAnimatorError as error:
        sys.exit(f"table1: {error}")
