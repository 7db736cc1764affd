"""A genetic algorithm beside the other ways to find controls, at equal time and at equal physics steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from control_cases.baselines.run_baseline import BaselineRun, run_baseline
from control_cases.control_table import DERIVATIVE_FREE, MIN_SECONDS, WARM_UP_TRIAL
from jaxtyping import Float

from neuroanimator.control.objective.objective_cost import objective_cost
from neuroanimator.control.synthesis.synthesise import Synthesis
from neuroanimator.control.tasks.all_tasks import TASKS
from neuroanimator.control.tasks.solver import Solver
from neuroanimator.control.tasks.task import Trial

Rows = list[dict[str, Any]]

RACES = ("pendulum-swing-up", "dolphin-swim")
"""Tasks in which rivals are run."""

TRIALS = 5
"""Number of trials of each task."""

PATIENCE = 12.0
"""Ratio of the time a rival gets to that which the emulator took."""

EMULATOR = "emulator"


def race_rows(is_quick: bool) -> Rows:
    """Return a row per task and way to find controls; J is on the true physics, its median over trials."""
    rows = []
    for name in RACES:
        solver = Solver.shipped(TASKS[name])
        solver.solve(solver.draw(WARM_UP_TRIAL), is_warm_up=True)
        rows += rows_of_task(solver, 1 if is_quick else TRIALS)
    return rows


def rows_of_task(solver: Solver, trials: int) -> Rows:
    """Return the rows of one task."""
    outcomes: dict[str, list[dict[str, float]]] = {}
    for number in range(trials):
        trial = solver.draw(number)
        synthesis, seconds = solver.solve(trial)
        outcomes.setdefault(EMULATOR, []).append(emulator_outcome(synthesis, seconds))
        for name in DERIVATIVE_FREE:
            run = rival_run(name, solver, trial, synthesis, seconds)
            outcome = rival_outcome(solver, trial, synthesis, seconds, run)
            outcomes.setdefault(name, []).append(outcome)
    return [_row(solver.task.name, name, found) for name, found in outcomes.items()]


def emulator_outcome(synthesis: Synthesis, seconds: float) -> dict[str, float]:
    """Return what the descent through the emulator and its replays came to."""
    cost = synthesis.outcome.cost_physics
    return {
        "reached": 1.0,
        "seconds": seconds,
        "physics_steps": synthesis.spent.physics_steps,
        "evaluations": synthesis.spent.iterations,
        "j_equal_time": cost,
        "j_equal_steps": cost,
        "j_at_last": cost,
    }


def rival_run(
    name: str, solver: Solver, trial: Trial, synthesis: Synthesis, seconds: float
) -> BaselineRun:
    """Return the rival's search for the J that the emulator led to, from the same first guess."""
    return run_baseline(
        name,
        solver.system,
        trial.objective,
        solver.parametrisation,
        solver.emulator.dt,
        trial.start,
        target=synthesis.outcome.cost_physics,
        seconds=max(MIN_SECONDS, PATIENCE * seconds),
        first=trial.first,
    )


def rival_outcome(
    solver: Solver, trial: Trial, synthesis: Synthesis, seconds: float, run: BaselineRun
) -> dict[str, float]:
    """Return J of the best the rival had after the emulator's time, after as many physics steps, and at last."""
    first = run.curve[0]
    by_time = first
    by_steps = first
    for improvement in run.curve:
        if improvement.seconds <= seconds:
            by_time = improvement
        if improvement.physics_steps <= synthesis.spent.physics_steps:
            by_steps = improvement
    return {
        "reached": float(run.is_reached),
        "seconds": run.spent_seconds,
        "physics_steps": run.spent_steps,
        "evaluations": run.evaluations,
        "j_equal_time": true_cost(solver, trial, by_time.z),
        "j_equal_steps": true_cost(solver, trial, by_steps.z),
        "j_at_last": true_cost(solver, trial, run.curve[-1].z),
    }


def true_cost(solver: Solver, trial: Trial, z: Float[np.ndarray, " Z"]) -> float:
    """Return J of `z` on the true physics, whatever scheme the rival stepped."""
    controls = np.asarray(solver.parametrisation.controls(z), float)
    runs = solver.system.simulate_fastest(trial.start[None], controls[None], solver.emulator.dt)
    return float(objective_cost(trial.objective, solver.emulator, runs.states[0], controls))


def _row(task: str, method: str, outcomes: list[dict[str, float]]) -> dict[str, Any]:
    row: dict[str, Any] = {"task": task, "method": method, "trials": len(outcomes)}
    row["reached"] = int(sum(outcome["reached"] for outcome in outcomes))
    for key in outcomes[0]:
        if key != "reached":
            row[key] = float(np.median([outcome[key] for outcome in outcomes]))
    return row
