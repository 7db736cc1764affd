"""Bring a soft body somewhere: through its emulator, and by CMA-ES on the physics.

python -m benchmarks.soft_bodies.soft_control flag                                         the flag that ships
python -m benchmarks.soft_bodies.soft_control flag --targets 2 --seconds 10 --dry
python -m benchmarks.soft_bodies.soft_control cloth cloth.toml cloth.emulator.safetensors  a user's own cloth

flag, cloth  the lowest corner is brought to a point by moving the mover that holds the cloth

A target of flag and cloth is the node's position at the end of a random motion of the true physics from rest, so that
it can be reached; motions that do not move the node are drawn again.

The emulator's method is `na.synthesise`: descent by its gradient, replays on the true physics, corrections by their errors.
CMA-ES evaluates the physics at its user's step, with fewer small steps than the truth, as many bodies side by side as it
can, for the same cost of the same splines. Both are judged on the true physics with all nodes [% of the body's size],
CMA-ES by its result after the time of the emulator's method, after the same number of small steps of physics, and at its end.
A node succeeds within 2 % of its target. All on one core, compiled before.
Writes soft_control_TASK.csv.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

import neuroanimator as na
from benchmarks.control.baselines.budgeted_cost import BudgetedCost, BudgetSpent, Improvement
from benchmarks.control.baselines.cost_evaluator import CostEvaluator
from benchmarks.control.baselines.derivative_free import cma_es
from benchmarks.control.baselines.fast_physics import FastPhysics
from benchmarks.harness import Clocks, Rows, keep_rows, parser_of, show_rows
from neuroanimator.control.descent.parametrisation import Parametrisation, Spline
from neuroanimator.control.objective.objective import Objective
from neuroanimator.learn.evaluation.speed import one_core
from neuroanimator.physics.soft.program import LANES
from neuroanimator.physics.soft.scene import Motion
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.terminal import progress_bar

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


CORNER = Task(lowest_corner, seconds=1.0, least_way=0.1)

TASKS = {"flag": CORNER, "cloth": CORNER}


class Problem(NamedTuple):
    """A task with one target."""

    system: SoftSystem
    emulator: na.Emulator
    steps: int
    """Super steps."""
    objective: Objective
    parametrisation: Parametrisation
    distance: Callable[[np.ndarray], float]
    """Returns how far from the target controls (T, C) lead, on the true physics with all nodes [the body's size]."""
    is_there: Callable[[np.ndarray], bool]
    """Returns whether controls (T, C) do what is to be done, on the true physics."""


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

    def distance(controls: np.ndarray) -> float:
        end = end_of_node(system, node, controls, emulator.dt)
        return float(np.linalg.norm(end - target)) / size

    def is_there(controls: np.ndarray) -> bool:
        return distance(controls) <= REACHED

    return Problem(system, emulator, steps, objective, parametrisation, distance, is_there)


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
    began = Clocks.now()
    found = na.synthesise(
        problem.emulator,
        problem.system,
        problem.objective,
        problem.system.rest,
        steps=problem.steps,
        options=na.SearchOptions(
            na.DescentOptions(parametrisation=problem.parametrisation), refinements=0
        ),
    )
    seconds = began.passed().seconds
    return {
        "seconds": seconds,
        "small_steps": found.spent.physics_steps,
        "iterations": found.spent.iterations,
        "error_percent": 100 * problem.distance(found.controls),
        "is_there": problem.is_there(found.controls),
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
    columns = judged(problem, "in_equal_time", in_time)
    columns |= judged(problem, "in_equal_steps", in_steps)
    columns |= judged(problem, "at_end", curve)
    columns["cma_seconds"] = curve[-1].seconds
    there = [better for better in curve if better.cost <= THERE]
    columns["cma_seconds_to_target"] = there[0].seconds if there else ""
    columns["cma_small_steps_to_target"] = there[0].physics_steps if there else ""
    return columns


def judged(problem: Problem, when: str, curve: list[Improvement]) -> dict[str, Any]:
    """Return the error of the last of a curve on the true physics [%], and whether it is there; nothing of an empty one."""
    error: float | str = ""
    is_there: bool | str = ""
    if curve:
        controls = np.asarray(problem.parametrisation.controls(curve[-1].z), float)
        error = 100 * problem.distance(controls)
        is_there = problem.is_there(controls)
    return {f"cma_error_{when}_percent": error, f"cma_is_there_{when}": is_there}


def problems(name: str, toml: Path | None, file: Path | None) -> Callable[[int], Problem]:
    """Return what makes the problem of each target of a cloth."""
    system = na.load_system(name if toml is None else str(toml))
    emulator = na.load_emulator(name if file is None else file)
    assert isinstance(system, SoftSystem)
    return partial(drawn, TASKS[name], system, emulator)


def task_rows(
    name: str, problem_of: Callable[[int], Problem], targets: int, seconds: float
) -> Rows:
    """Return a row for each target."""
    by_emulator(problem_of(WARM_UP))
    rows: Rows = []
    with progress_bar(name, targets) as bar:
        for number in range(targets):
            problem = problem_of(number)
            found = by_emulator(problem)
            row: dict[str, Any] = {"task": name, "target": number}
            row["nodes"] = len(problem.system.shapes.mean)
            row |= found
            row |= by_cma(problem, seconds, found, number)
            rows.append(row)
            bar.advance_to(number + 1)
    return rows


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("task", choices=TASKS)
    parser.add_argument("toml", type=Path, nargs="?")
    parser.add_argument("emulator", type=Path, nargs="?")
    parser.add_argument("--targets", type=int, default=TARGETS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of CMA-ES, for a target")
    arguments = parser.parse_args()
    name = arguments.task
    problem_of = problems(name, arguments.toml, arguments.emulator)
    with one_core():
        rows = task_rows(name, problem_of, arguments.targets, arguments.seconds)
    show_rows(rows)
    keep_rows(Path(__file__).with_name(f"soft_control_{name}.csv"), rows, arguments)


if __name__ == "__main__":
    main()
