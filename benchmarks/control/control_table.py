"""Control tasks, solved through the emulator and by its baselines on the physics: a row per task and method."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.control.baselines.ilqr import is_usable_on
from benchmarks.control.baselines.run_baseline import BASELINES, BaselineRun, run_baseline
from benchmarks.control.first_controller import cold_seconds
from benchmarks.control.solve_trial import gradient_cosine, solve_trial
from benchmarks.harness import quartiles
from neuroanimator.control.objective.costs import effort
from neuroanimator.control.objective.goals import reach_goal
from neuroanimator.control.objective.objective import ALL_ALONG, Objective
from neuroanimator.control.synthesis.synthesise import Synthesis
from neuroanimator.learn.planning.planner import Planner
from neuroanimator.learn.planning.plants import control_plant
from neuroanimator.learn.tasks.solver import Solver
from neuroanimator.learn.tasks.task import Task, Trial
from neuroanimator.systems.plants import PhysicsPlant
from neuroanimator.terminal import progress_bar

Rows = list[dict[str, Any]]

DERIVATIVE_FREE = ("annealing", "cma-es", "genetic", "nelder-mead")
"""The baselines that need no derivatives of the physics, which is what the speed-up is told against."""

WARM_UP_TRIAL = 10_000
"""The number of the trial that compiles everything; it is not among those measured."""

PLANNED_STEPS = 30
"""Horizon of a re-plan [super steps]."""

DRIVEN_STEPS = 120
"""Number of super steps planned and driven."""

EFFORT_WEIGHT = 0.1
"""Weight of the effort beside a goal to come to."""

HELD_EFFORT_WEIGHT = 1.0
"""Weight of the effort beside a goal to be held: holding a pendulum upright takes little."""

MIN_SECONDS = 0.5
"""A baseline gets at least this time [s]."""

DIGITS = 2
"""Number of digits of times: they differ by more from run to run."""


@dataclass(frozen=True)
class ControlBudget:
    """How much is measured."""

    trials: int
    """Random instances of each task."""
    runs: int
    """Trials in which baselines look for the J that was found."""
    patience: float
    """Ratio of the time a baseline gets to that which the emulator took."""
    cosines: int
    """Trials in which the emulator's gradient is held against the physics'."""


QUICK = ControlBudget(trials=100, runs=1, patience=20.0, cosines=1)
"""Minutes; that a baseline takes 15 times as long can be seen, in one trial."""

THOROUGH = ControlBudget(trials=100, runs=5, patience=20.0, cosines=10)
"""Twenty minutes."""


@dataclass(frozen=True)
class Solved:
    """One trial: what was found, and how long it took [s]."""

    trial: Trial
    synthesis: Synthesis
    seconds: float

    @property
    def is_success(self) -> bool:
        """Whether the true physics did it."""
        return self.trial.is_success(self.synthesis.outcome.physics_states)


def measure_tasks(tasks: list[Task], budget: ControlBudget) -> Rows:
    """Return a row per task and method: the emulator's, then its baselines' on the true physics."""
    rows: Rows = []
    with progress_bar("tasks", len(tasks)) as bar:
        for number, task in enumerate(tasks):
            bar.advance_to(number, task.name)
            rows += measure_task(task, budget)
    return rows


def measure_task(task: Task, budget: ControlBudget) -> Rows:
    """Return the emulator's row and its baselines'; compiling is not counted on either side."""
    solver = Solver.shipped(task)
    solve_trial(solver, solver.draw(WARM_UP_TRIAL), is_warm_up=True)
    solved = [_solve(solver, number) for number in range(budget.trials)]
    compared = _compared(solved, budget)
    runs = {}
    for name in baselines_of(solver):
        runs[name] = [run_for(name, solver, one_solved, budget) for one_solved in compared]
    cosines = []
    for number, one_solved in enumerate(solved[: budget.cosines]):
        cosines.append(gradient_cosine(solver, one_solved.trial, number))
    emulator_row = row_of_emulator(solver, solved, cosines) | speed_up(compared, runs)
    of_baselines = [row_of_baseline(task, name, of_name) for name, of_name in runs.items()]
    return [emulator_row, *of_baselines]


def _solve(solver: Solver, number: int) -> Solved:
    trial = solver.draw(number)
    synthesis, seconds = solve_trial(solver, trial)
    return Solved(trial, synthesis, seconds)


def _compared(solved: list[Solved], budget: ControlBudget) -> list[Solved]:
    """Return the trials in which baselines are run: the first that succeeded, or the first of all if none did."""
    successes = [one_solved for one_solved in solved if one_solved.is_success]
    return successes[: budget.runs] or solved[: budget.runs]


def baselines_of(solver: Solver) -> list[str]:
    """Return the names of the baselines that can be used on the task's system."""
    is_differentiable = is_usable_on(solver.system)
    return [name for name in BASELINES if name != "ilqr" or is_differentiable]


def run_for(name: str, solver: Solver, solved: Solved, budget: ControlBudget) -> BaselineRun:
    """Return how a baseline fares in a trial, looking for the J the emulator led to, from the same first guess."""
    return run_baseline(
        name,
        solver.system,
        solved.trial.objective,
        solver.parametrisation,
        solver.emulator.dt,
        solved.trial.start,
        target=solved.synthesis.outcome.cost_physics,
        seconds=max(MIN_SECONDS, budget.patience * solved.seconds),
        first=solved.trial.first,
    )


def row_of_emulator(solver: Solver, solved: list[Solved], cosines: list[float]) -> dict[str, Any]:
    """Return what the emulator achieved; medians are over trials."""
    task = solver.task
    syntheses = [one_solved.synthesis for one_solved in solved]
    seconds = [one_solved.seconds for one_solved in solved]
    return {
        "task": task.name,
        "method": f"emulator, {task.method}",
        "success": task.success,
        "trials": len(solved),
        "success_rate": float(np.mean([one_solved.is_success for one_solved in solved])),
        "iterations_median": median(synthesis.spent.iterations for synthesis in syntheses),
        "corrections_median": median(synthesis.spent.corrections for synthesis in syntheses),
        "seconds_median": median(seconds),
        "seconds_quartiles": quartiles(seconds, DIGITS),
        "cold_seconds": cold_seconds(task.name),
        "physics_steps_median": median(synthesis.spent.physics_steps for synthesis in syntheses),
        "j_physics_median": median(synthesis.outcome.cost_physics for synthesis in syntheses),
        "gradient_cosine_median": median(cosines),
        "replan_p99_ms": replan_p99_ms(solver),
    }


def median(values: Iterable[float]) -> float:
    """Return the median of `values`."""
    return float(np.median(list(values)))


def speed_up(compared: list[Solved], runs: dict[str, list[BaselineRun]]) -> dict[str, Any]:
    """Return how many times as long the best derivative-free baseline takes to the same J on the physics; at least."""
    ratios = {name: time_ratio(compared, runs[name]) for name in DERIVATIVE_FREE}
    best = min(ratios, key=ratios.__getitem__)
    return {
        "speedup_over_best_baseline": ratios[best],
        "best_baseline": best,
        "best_baseline_reached": float(np.mean([run.is_reached for run in runs[best]])),
        "speedup_over_ilqr": time_ratio(compared, runs["ilqr"]) if "ilqr" in runs else "",
    }


def time_ratio(compared: list[Solved], runs: list[BaselineRun]) -> float:
    """Return the median of the baseline's time over the emulator's; one that never arrived counts with all it had."""
    pairs = zip(runs, compared, strict=True)
    return median(run.spent_seconds / one_solved.seconds for run, one_solved in pairs)


def row_of_baseline(task: Task, name: str, runs: list[BaselineRun]) -> dict[str, Any]:
    """Return what a baseline achieved in the trials it was run in; a success is a J as low as the emulator led to."""
    seconds = [run.spent_seconds for run in runs]
    return {
        "task": task.name,
        "method": name,
        "success": "J on the physics as low as through the emulator",
        "trials": len(runs),
        "success_rate": float(np.mean([run.is_reached for run in runs])),
        "iterations_median": median(run.evaluations for run in runs),
        "corrections_median": "",
        "seconds_median": median(seconds),
        "seconds_quartiles": quartiles(seconds, DIGITS),
        "cold_seconds": "",
        "physics_steps_median": median(run.spent_steps for run in runs),
        "j_physics_median": median(run.cost for run in runs),
        "gradient_cosine_median": "",
        "replan_p99_ms": "",
        "speedup_over_best_baseline": "",
        "best_baseline": "",
        "best_baseline_reached": "",
        "speedup_over_ilqr": "",
    }


def replan_p99_ms(solver: Solver) -> float | str:
    """Return how long a re-plan takes at most but once in a hundred times, on the way to the system's goal."""
    objective = holding(solver)
    if objective is None:
        return ""
    planner = Planner.of(solver.emulator, objective, PLANNED_STEPS)
    plant = PhysicsPlant(solver.system, solver.emulator.dt)
    return control_plant(planner, plant, solver.draw(0).start, DRIVEN_STEPS).p99_ms


def holding(solver: Solver) -> Objective | None:
    """Return the objective to come to the system's goal; None where it names none.

    A goal that must be held is wanted at every super step, any other by the end of the horizon.
    """
    system = solver.system
    if not system.goals:
        return None
    goal = next(iter(system.goals.values()))
    if solver.task.is_held:
        held = reach_goal(system, goal, when=ALL_ALONG)
        return Objective.of(effort(HELD_EFFORT_WEIGHT), held)
    return Objective.of(effort(EFFORT_WEIGHT), reach_goal(system, goal))
