"""The tasks of `control`, solved through the emulator and by its rivals on the physics: rows, CSV, plot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator.bench.baselines.race import RIVALS, Race, race
from neuroanimator.bench.control_plot import Panel, draw_races
from neuroanimator.bench.run_table import write_csv
from neuroanimator.control.objective.costs import effort
from neuroanimator.control.objective.goals import reach_goal, stand_upright
from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.synthesis.receding_horizon import PhysicsPlant, Planner, all_along, drive
from neuroanimator.control.synthesis.synthesise import Synthesis
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.systems import load_system
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.tasks.rigid import RIGID_TASKS
from neuroanimator.tasks.solver import Solver
from neuroanimator.tasks.swimmers import ANIMAL_TASKS
from neuroanimator.tasks.task import Task, Trial
from neuroanimator.terminal import progress_bar
from neuroanimator.zoo import find_emulator

TASKS = {task.name: task for task in (*RIGID_TASKS, *ANIMAL_TASKS)}
DERIVATIVE_FREE = ("annealing", "cma-es", "nelder-mead")
WARM_UP_TRIAL = 10_000
"""Its number is not among those measured."""
PLANNED_STEPS, DRIVEN_STEPS = 30, 120
"""Super steps a re-plan looks ahead, and how many are planned and driven."""


@dataclass(frozen=True)
class Thoroughness:
    """How much is measured."""

    trials: int
    races: int
    """Trials in which rivals race for the J that was found."""
    patience: float
    """Times as long as the emulator took that a rival gets."""
    cosines: int


QUICK = Thoroughness(trials=10, races=1, patience=5.0, cosines=1)
THOROUGH = Thoroughness(trials=100, races=5, patience=20.0, cosines=10)
MIN_SECONDS = 0.5
"""[s] A rival gets at least this."""


@dataclass(frozen=True)
class Solved:
    """One trial: what was found, and how long it took [s]."""

    trial: Trial
    found: Synthesis
    seconds: float

    @property
    def is_success(self) -> bool:
        """Whether the true physics did it."""
        return self.trial.is_success(self.found.outcome.physics_states)


def chosen_tasks(names: str | None) -> list[Task]:
    """Return the tasks that comma-separated names choose; all without."""
    wanted = names.split(",") if names else list(TASKS)
    unknown = [name for name in wanted if name not in TASKS]
    if unknown:
        raise ArgumentError(
            f"bench: no task called {', '.join(unknown)}. Tasks: {', '.join(TASKS)}."
        )
    return [TASKS[name] for name in wanted]


def run_control_bench(
    tasks: list[Task], out: Path, effort: Thoroughness
) -> tuple[list[dict[str, Any]], list[Path]]:
    """Return (a row per task and method, files written)."""
    rows, panels = [], []
    with progress_bar("tasks", len(tasks)) as bar:
        for task in tasks:
            bar.advance_to(len(panels), task.name)
            found, panel = measure_task(task, effort)
            rows += found
            panels.append(panel)
    table, plot = out / "control.csv", out / "control.png"
    write_csv(table, rows)
    draw_races(panels, plot)
    return rows, [table, plot]


def measure_task(task: Task, effort: Thoroughness) -> tuple[list[dict[str, Any]], Panel]:
    """Return the emulator's row and its rivals', and its first race; compiling is not counted on either side."""
    solver = Solver.of(
        task,
        load_system(task.system),
        Emulator.load(find_emulator(f"{task.system}-{task.substeps}")),
    )
    solver.solve(solver.draw(WARM_UP_TRIAL), is_warm_up=True)
    solved = []
    for number in range(effort.trials):
        trial = solver.draw(number)
        solved.append(Solved(trial, *solver.solve(trial)))
    won = [each for each in solved if each.is_success][: effort.races] or solved[: effort.races]
    races = {
        name: [run_race(name, solver, each, effort) for each in won] for name in rivals_of(solver)
    }
    cosines = [
        solver.cosine(each.trial, number) for number, each in enumerate(solved[: effort.cosines])
    ]
    ours = own_row(solver, solved, cosines) | speed_up(won, races)
    rows = [ours, *(rival_row(task, name, won, found) for name, found in races.items())]
    return rows, Panel(
        task.name, won[0].found, won[0].seconds, [found[0] for found in races.values()]
    )


def rivals_of(solver: Solver) -> list[str]:
    """Return the names of the rivals that can be used on the task's system."""
    return [name for name in RIVALS if name != "ilqr" or isinstance(solver.system, MujocoSystem)]


def run_race(name: str, solver: Solver, solved: Solved, effort: Thoroughness) -> Race:
    """Return how a rival fares in a trial, racing for the J the emulator led to, from the same first guess."""
    return race(
        name, solver.system, solved.trial.objective, solver.parametrisation, solver.emulator.dt, solved.trial.start,
        target=solved.found.outcome.cost_physics, seconds=max(MIN_SECONDS, effort.patience * solved.seconds),
        first=solved.trial.first,
    )  # fmt: skip


def own_row(solver: Solver, solved: list[Solved], cosines: list[float]) -> dict[str, Any]:
    """Return what the emulator achieved; medians are over trials."""
    task, found = solver.task, [each.found for each in solved]
    return {
        "task": task.name,
        "method": f"emulator, {task.method}",
        "success": task.success,
        "trials": len(solved),
        "success_rate": float(np.mean([each.is_success for each in solved])),
        "iterations_median": float(np.median([each.descent.iterations for each in found])),
        "corrections_median": float(np.median([each.corrections for each in found])),
        "seconds_median": float(np.median([each.seconds for each in solved])),
        "seconds_quartiles": quartiles([each.seconds for each in solved]),
        "physics_steps_median": float(np.median([each.physics_steps for each in found])),
        "j_physics_median": float(np.median([each.outcome.cost_physics for each in found])),
        "gradient_cosine_median": float(np.median(cosines)),
        "replan_p99_ms": replan_p99_ms(solver),
    }


def speed_up(won: list[Solved], races: dict[str, list[Race]]) -> dict[str, Any]:
    """Return how many times as long the best derivative-free rival takes to the same J on the physics; at least."""
    ratios = {name: time_ratio(won, races[name]) for name in DERIVATIVE_FREE}
    best = min(ratios, key=ratios.__getitem__)
    reached = np.mean([found.is_reached for found in races[best]])
    return {
        "speedup_over_best_rival": ratios[best],
        "best_rival": best,
        "best_rival_reached": float(reached),
        "speedup_over_ilqr": time_ratio(won, races["ilqr"]) if "ilqr" in races else "",
    }


def time_ratio(won: list[Solved], races: list[Race]) -> float:
    """Return the median of the rival's time over the emulator's; a rival that never arrived counts with all it had."""
    times = [found.reached_seconds or found.seconds for found in races]
    return float(np.median([time / each.seconds for time, each in zip(times, won, strict=True)]))


def rival_row(task: Task, name: str, won: list[Solved], races: list[Race]) -> dict[str, Any]:
    """Return what a rival achieved in the trials it raced in; a success is a J as low as the emulator led to."""
    return {
        "task": task.name,
        "method": name,
        "success": "J on the physics as low as through the emulator",
        "trials": len(races),
        "success_rate": float(np.mean([found.is_reached for found in races])),
        "iterations_median": float(np.median([found.evaluations for found in races])),
        "corrections_median": "",
        "seconds_median": float(
            np.median([found.reached_seconds or found.seconds for found in races])
        ),
        "seconds_quartiles": quartiles([found.reached_seconds or found.seconds for found in races]),
        "physics_steps_median": float(
            np.median([found.reached_steps or found.physics_steps for found in races])
        ),
        "j_physics_median": float(np.median([found.cost for found in races])),
        "gradient_cosine_median": "",
        "replan_p99_ms": "",
        "speedup_over_best_rival": "",
        "best_rival": "",
        "best_rival_reached": "",
        "speedup_over_ilqr": "",
    }


def quartiles(values: list[float]) -> str:
    """Return the quartiles, such as `0.02-0.06`."""
    low, high = np.percentile(values, [25, 75])
    return f"{low:.2g}-{high:.2g}"


def replan_p99_ms(solver: Solver) -> float | str:
    """Return how long a re-plan takes at most but once in a hundred times, on the way to the system's goal."""
    objective = holding(solver)
    if objective is None:
        return ""
    planner = Planner.of(solver.emulator, objective, PLANNED_STEPS)
    plant = PhysicsPlant(solver.system, solver.emulator.dt)
    return drive(planner, plant, solver.draw(0).start, DRIVEN_STEPS).p99_ms


def holding(solver: Solver) -> Objective | None:
    """Return the wish to come to the goal and stay there, wherever within the horizon; None for animals."""
    system, dt = solver.system, solver.emulator.dt
    if system.name == "pendulum":
        return stand_upright(1.0, dt, all_along(PLANNED_STEPS, dt))
    if not isinstance(system, MujocoSystem):
        return None
    goal = next(iter(system.goals.values()))
    return Objective.of(effort(0.1), reach_goal(system.structure, system.rest, goal))
