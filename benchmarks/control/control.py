"""Controllers, part by part; each writes control_PART.csv.

python -m benchmarks.control.control tasks                     every task through the emulator, and its baselines: twenty minutes
python -m benchmarks.control.control descents                  every method of descent on every task
python -m benchmarks.control.control tasks --quick             one race per task: minutes; writes no file
python -m benchmarks.control.control tasks --tasks truck-park  these tasks alone; writes no file
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.control.control_table import DIGITS, QUICK, THOROUGH, measure_tasks
from benchmarks.harness import Rows, keep_rows, parser_of, quartiles, show_rows
from neuroanimator import DescentOptions, descend, load_emulator, load_system
from neuroanimator.control.descent.methods import METHODS
from neuroanimator.control.synthesis.replay import replay
from neuroanimator.errors import ArgumentError, NeuroAnimatorError
from neuroanimator.learn.tasks.all_tasks import TASKS
from neuroanimator.learn.tasks.solver import Solver
from neuroanimator.learn.tasks.task import Task

ITERATIONS = (20, 100)
"""Maximum numbers of iterations of a descent."""

TRIALS = 12
"""Number of trials over which medians are taken."""


def descent_rows(tasks: list[Task], is_quick: bool) -> Rows:
    """Return a row per task, method and number of iterations: J on the emulator and at the first replay."""
    rows = []
    for task in tasks:
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


PRINTED = (
    "task",
    "method",
    "success_rate",
    "iterations_median",
    "seconds_median",
    "cold_seconds",
    "j_physics_median",
    "speedup_over_best_baseline",
    "best_baseline",
    "gradient_cosine_median",
    "replan_p99_ms",
)
"""Columns of the part `tasks` that are printed; its CSV file has more."""

RESULTS = Path(__file__).parent


def chosen_tasks(names: str | None) -> list[Task]:
    """Return the tasks that comma-separated names choose; all without."""
    chosen = names.split(",") if names else list(TASKS)
    unknown = [name for name in chosen if name not in TASKS]
    if unknown:
        raise ArgumentError(f"No task called {', '.join(unknown)}. Tasks: {', '.join(TASKS)}.")
    return [TASKS[name] for name in chosen]


def main() -> None:
    parser = parser_of(__doc__, quick="fewer trials")
    parser.add_argument("part", choices=("tasks", "descents"))
    parser.add_argument(
        "--tasks", help="only these, such as fish-turn,truck-park; others' rows stay as they are"
    )
    parser.add_argument("--trials", type=int, default=100, help="random starts of each task")
    parser.add_argument("--json", action="store_true", help="print all columns as JSON")
    options = parser.parse_args()
    tasks = chosen_tasks(options.tasks)
    columns: tuple[str, ...] = ()
    if options.part == "tasks":
        budget = replace(QUICK if options.quick else THOROUGH, trials=options.trials)
        rows = measure_tasks(tasks, budget)
        columns = PRINTED
    else:
        rows = descent_rows(tasks, options.quick)
    table = RESULTS / f"control_{options.part}.csv"
    keep_rows(table, rows, options, "task", order=lambda row: list(TASKS).index(row["task"]))
    if options.json:
        print(json.dumps(rows, indent=2))
    else:
        show_rows(rows, *columns)


if __name__ == "__main__":
    try:
        main()
    except NeuroAnimatorError as error:
        sys.exit(f"control: {error}")
