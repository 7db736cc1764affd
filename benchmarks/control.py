"""Controllers, part by part; each writes results/control_PART.csv.

python benchmarks/control.py tasks               every task through the emulator, and its baselines (as bench --control)
python benchmarks/control.py descents            every way of descending on every task
python benchmarks/control.py descents --quick    fewer trials; writes no file
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from neuroanimator import DescentOptions, descend, load_emulator, load_system
from neuroanimator.bench.csv_table import quartiles, write_csv
from neuroanimator.bench.run_control import DIGITS, QUICK, TASKS, THOROUGH, run_control_bench
from neuroanimator.control.descent.methods import METHODS
from neuroanimator.control.synthesis.replay import replay
from neuroanimator.machine import describe_machine
from neuroanimator.tasks.solver import Solver
from neuroanimator.terminal import print_table

Rows = list[dict[str, Any]]
ITERATIONS = (20, 100)
"""Descents are stopped after so many iterations."""

TRIALS = 12
"""Medians are over so many trials."""


def task_rows(is_quick: bool) -> Rows:
    """Return what `bench --control` does."""
    budget = QUICK if is_quick else THOROUGH
    with TemporaryDirectory() as folder:
        rows, _ = run_control_bench(list(TASKS.values()), Path(folder), budget)
    return rows


def descent_rows(is_quick: bool) -> Rows:
    """Return a row per task, method and number of iterations: J on the emulator and at the first replay."""
    rows = []
    for task in TASKS.values():
        emulator = load_emulator(f"{task.system}-{task.substeps}")
        solver = Solver.of(task, load_system(task.system), emulator)
        for method in METHODS:
            rows += [
                descent_row(solver, method, iterations, 2 if is_quick else TRIALS)
                for iterations in ITERATIONS
            ]
    return rows


def descent_row(solver: Solver, method: str, iterations: int, trials: int) -> dict[str, Any]:
    """Return medians over trials; one first guess each, no corrections."""
    descents = []
    costs_on_physics = []
    for number in range(trials):
        trial = solver.draw(number)
        options = DescentOptions(
            method=method,
            iterations=iterations,
            first=trial.first,
            parametrisation=solver.parametrisation,
        )
        descent = descend(
            solver.emulator, trial.objective, trial.start, steps=solver.steps, options=options
        )
        descents.append(descent)
        outcome = replay(
            solver.emulator, solver.system, trial.objective, trial.start, descents[-1].controls
        )
        costs_on_physics.append(outcome.cost_physics)
    return {
        "task": solver.task.name,
        "numbers": solver.parametrisation.size,
        "method": method,
        "iterations_allowed": iterations,
        "iterations": float(np.median([descent.iterations for descent in descents])),
        "milliseconds": float(np.median([descent.seconds for descent in descents])) * 1e3,
        "J_emulator": float(np.median([descent.cost for descent in descents])),
        "J_emulator_quartiles": quartiles([descent.cost for descent in descents], DIGITS),
        "J_physics": float(np.median(costs_on_physics)),
    }


PARTS = {"tasks": task_rows, "descents": descent_rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--quick", action="store_true", help="fewer trials; writes no file")
    options = parser.parse_args()
    rows = PARTS[options.part](options.quick)
    if not options.quick:
        write_csv(Path(__file__).parent / "results" / f"control_{options.part}.csv", rows)
    print(describe_machine())
    print_table(rows)


if __name__ == "__main__":
    main()
