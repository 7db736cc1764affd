"""Bring a node of a soft body to a point: through its emulator, and by CMA-ES on the physics in C.

python benchmarks/soft_control.py flag flag.toml flag.emulator.safetensors
python benchmarks/soft_control.py jelly jelly.toml jelly.emulator.safetensors
python benchmarks/soft_control.py flag flag.toml flag.emulator.safetensors --targets 2 --seconds 10 --dry

flag   the corner that hangs lowest is brought to a point by moving what holds the cloth
jelly  the middle of a body that nothing holds is thrown to a point, a bin's, by moving the paddle

A target is where the node comes to at the end of a random motion of the true physics from rest, so that it can be
reached; motions that leave the node where it is are drawn again. The emulator's way is `na.synthesise`: descent by its
gradient, replays on the true physics, corrections by what those show. CMA-ES asks the physics at its user's step, with
fewer small steps than the truth, sixteen bodies side by side, for the same cost of the same splines. Both are judged by
the node of the true physics with all nodes [% of the body's size]: CMA-ES with what it had after the time that the
emulator's way took, after as many small steps of physics, and at its end. All on one core, compiled before.
Writes results/soft_control_TASK.csv.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from control_cases.baselines.budgeted_cost import BudgetedCost, BudgetSpent, Improvement
from control_cases.baselines.cost_evaluator import CostEvaluator
from control_cases.baselines.derivative_free import cma_es
from control_cases.baselines.fast_physics import FastPhysics
from jaxtyping import Bool, Float

import neuroanimator as na
from neuroanimator.control.descent.parametrisation import Parametrisation, Spline
from neuroanimator.control.objective.objective import Objective
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.speed import one_core
from neuroanimator.systems.soft.program import LANES
from neuroanimator.systems.soft.scene import Motion
from neuroanimator.systems.soft.soft_system import SoftSystem
from neuroanimator.terminal import print_table, progress_bar

Rows = list[dict[str, Any]]

RESULTS = Path(__file__).parent / "results"

TARGETS = 10
"""Number of random targets."""

SECONDS = 60.0
"""Time CMA-ES has for a target [s]."""

KNOTS = 6
"""Number of knots of the splines of each control."""

REACHED = 0.02
"""A node that is nearer to its target is there [the body's size]."""

THERE = 0.5
"""J of a motion that ends so far from its target, effort apart."""

EFFORT = 1e-3
"""Weight of effort: of two ways to the target, the calmer."""

SPREAD = 1.0
"""Spread of the numbers of random motions."""

SEED = 2**31
"""Seed of the targets, above any of a dataset's."""

MAX_DRAWS = 1000
"""Motions drawn for a target, until one moves the node."""

WARM_UP = -1
"""Number of the target that everything is compiled with."""


@dataclass(frozen=True)
class Task:
    """What is to be done with a body."""

    node: Callable[[SoftSystem], int]
    """Which node is to be somewhere."""
    seconds: float
    """Length of the motion [s]."""
    least_way: float
    """Distance of a target from where the node is at rest [the body's size]."""


def lowest_corner(system: SoftSystem) -> int:
    """Return the node that lies lowest and most to one side."""
    nodes = system.shapes.decode(system.rest)
    return int((nodes[:, 0] - 2 * nodes[:, 2]).argmax())


def middle(system: SoftSystem) -> int:
    """Return the node that is nearest to the middle of the body."""
    nodes = system.shapes.decode(system.rest)
    return int(np.linalg.norm(nodes - nodes.mean(axis=0), axis=1).argmin())


TASKS = {
    "flag": Task(lowest_corner, seconds=1.0, least_way=0.1),
    "jelly": Task(middle, seconds=1.0, least_way=0.5),
}


class Problem(NamedTuple):
    """A task with one target."""

    system: SoftSystem
    emulator: na.Emulator
    node: int
    target: np.ndarray
    """[m]"""
    steps: int
    """Super steps."""
    objective: Objective
    parametrisation: Parametrisation

    def distance(self, controls: Float[np.ndarray, "T C"]) -> float:
        """Return how far the node is from its target at the end, on the true physics with all nodes [the body's size]."""
        end = end_of_node(self.system, self.node, controls, self.emulator.dt)
        return float(np.linalg.norm(end - self.target)) / self.system.scene.size


def end_of_node(
    system: SoftSystem, node: int, controls: Float[np.ndarray, "T C"], dt: float
) -> Float[np.ndarray, " 3"]:
    """Return where a node is after `controls` from rest, on the true physics [m]."""
    size = system.control.size
    changes = dt * np.concatenate([np.zeros((1, size)), controls])
    paths = system.rest[:size] + np.cumsum(changes, axis=0)
    motion = Motion(*(part[..., 0] for part in system.motion(system.rest[None])))
    steps = system.truth.steps(dt)
    positions, _ = system.scene.play(motion, paths, dt, steps)
    return np.asarray(positions[-1, node] + motion.origin, float)


def drawn(task: Task, system: SoftSystem, emulator: na.Emulator, number: int) -> Problem:
    """Return the problem of target number `number`."""
    rng = np.random.default_rng([SEED, number - WARM_UP])
    node = task.node(system)
    steps = round(task.seconds / emulator.dt)
    parametrisation = Spline.of(steps, KNOTS, emulator.bounds)
    rest = system.shapes.decode(system.rest, [node])[0]
    size = system.scene.size
    for _ in range(MAX_DRAWS):
        z = rng.normal(scale=SPREAD, size=parametrisation.size)
        controls = np.asarray(parametrisation.controls(z), float)
        target = end_of_node(system, node, controls, emulator.dt)
        if np.linalg.norm(target - rest) > task.least_way * size:
            break
    near = na.reach_node(system, node, target, within=REACHED * size)
    objective = na.Objective.of(near, na.effort(EFFORT))
    return Problem(system, emulator, node, target, steps, objective, parametrisation)


class SoftPhysics(FastPhysics):
    """A soft body from rest at its user's step, sixteen side by side."""

    def __init__(self, system: SoftSystem, dt: float, length: int):
        self.system = system
        self.dt = dt
        self.steps = length * system.scheme.steps(dt)

    def rollout(
        self, controls: Float[np.ndarray, "B T C"]
    ) -> tuple[Float[np.ndarray, "G T S L"], Bool[np.ndarray, " B"]]:
        count = len(controls)
        if count > 1:
            controls = controls[np.arange(LANES).clip(max=count - 1)]
        starts = np.repeat(self.system.rest[None], len(controls), axis=0)
        runs = self.system.simulate(starts, controls, self.dt, scheme=self.system.scheme)
        lanes = np.moveaxis(runs.states[:, 1:], 0, -1)
        return lanes[None], runs.has_diverged[:count]


def by_emulator(problem: Problem) -> dict[str, Any]:
    """Return what the emulator's way took, and where it led."""
    began = time.perf_counter()
    found = na.synthesise(
        problem.emulator,
        problem.system,
        problem.objective,
        problem.system.rest,
        steps=problem.steps,
        options=na.DescentOptions(parametrisation=problem.parametrisation),
        refinements=0,
    )
    seconds = time.perf_counter() - began
    return {
        "seconds": seconds,
        "small_steps": found.spent.physics_steps,
        "iterations": found.spent.iterations,
        "error_percent": 100 * problem.distance(found.controls),
    }


def by_cma(problem: Problem, seconds: float, equal: dict[str, Any], number: int) -> dict[str, Any]:
    """Return where CMA-ES on the physics was after what the emulator's way took, `equal`, and at its end."""
    physics = SoftPhysics(problem.system, problem.emulator.dt, problem.steps)
    evaluator = CostEvaluator(
        physics,
        problem.objective,
        problem.parametrisation,
        problem.emulator.dt,
        problem.system.rest,
        problem.emulator.bounds.magnitude,
        LANES,
    )
    first = problem.parametrisation.guess(None)
    evaluator.costs(np.repeat(first[None], 2, axis=0))  # compiles
    rng = np.random.default_rng([SEED, 1, number - WARM_UP])
    budget = BudgetedCost(evaluator, -np.inf, max(seconds, equal["seconds"]))
    with suppress(BudgetSpent):
        cma_es(budget, first, rng)
    curve = budget.curve
    in_time = [better for better in curve if better.seconds <= equal["seconds"]]
    in_steps = [better for better in curve if better.physics_steps <= equal["small_steps"]]
    errors: dict[str, Any] = {
        "cma_error_in_equal_time_percent": error_of(problem, in_time),
        "cma_error_in_equal_steps_percent": error_of(problem, in_steps),
        "cma_error_at_end_percent": error_of(problem, curve),
        "cma_seconds": curve[-1].seconds,
    }
    there = [better for better in curve if better.cost <= THERE]
    errors["cma_seconds_to_target"] = there[0].seconds if there else ""
    errors["cma_small_steps_to_target"] = there[0].physics_steps if there else ""
    return errors


def error_of(problem: Problem, curve: list[Improvement]) -> float | str:
    """Return the error of the last of a curve on the true physics [%]; nothing of one that has not begun."""
    if not curve:
        return ""
    controls = np.asarray(problem.parametrisation.controls(curve[-1].z), float)
    return 100 * problem.distance(controls)


def task_rows(name: str, toml: Path, file: Path, targets: int, seconds: float) -> Rows:
    """Return a row for each target."""
    task = TASKS[name]
    system = na.load_system(str(toml))
    emulator = na.Emulator.load(file)
    assert isinstance(system, SoftSystem)
    by_emulator(drawn(task, system, emulator, WARM_UP))
    rows: Rows = []
    with progress_bar(name, targets) as bar:
        for number in range(targets):
            problem = drawn(task, system, emulator, number)
            found = by_emulator(problem)
            row: dict[str, Any] = {"task": name, "target": number, "nodes": len(system.shapes.mean)}
            row |= found
            row["is_there"] = found["error_percent"] <= 100 * REACHED
            row |= by_cma(problem, seconds, found, number)
            rows.append(row)
            bar.advance_to(number + 1)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("task", choices=tuple(TASKS))
    parser.add_argument("toml", type=Path)
    parser.add_argument("emulator", type=Path)
    parser.add_argument("--targets", type=int, default=TARGETS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of CMA-ES, for a target")
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    with one_core():
        rows = task_rows(
            arguments.task,
            arguments.toml,
            arguments.emulator,
            arguments.targets,
            arguments.seconds,
        )
    print(describe_machine())
    print_table(rows)
    if not arguments.dry:
        write_csv(RESULTS / f"soft_control_{arguments.task}.csv", rows)


if __name__ == "__main__":
    main()
