"""Three tasks of dm_control by planning through an emulator of each one's model, trained with default settings.

python -m benchmarks.control.dm_control_suite               all of them, an hour on 2 cores; a table, and dm_control_suite.csv
python -m benchmarks.control.dm_control_suite fish-swim     one of them; writes no file
python -m benchmarks.control.dm_control_suite --episodes 3  fewer episodes; writes no file

Needs dm_control: pip install "dm_control<1.0.50", the last one for this MuJoCo.
Emulators are kept in out/dm_control and used again.

For each: `new` on the task's own MJCF, `generate` and `train` with defaults, then 20 episodes with seeds 0 to 19. The constants
below and the costs were chosen on seeds 100 to 103. For comparison: doing nothing, and random actions, in the same episodes.

This is not learning from reward alone. The model is known and may be reset to any state, and the objective is written by hand
after the reward.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import neuroanimator as na
from benchmarks.harness import keep_rows, parser_of, show_rows
from neuroanimator import control
from neuroanimator.learn.data.config import RUN_STEPS
from neuroanimator.learn.evaluation.accuracy import one_step_error, root_mean_square
from neuroanimator.learn.evaluation.held_out import held_out_runs, system_of
from neuroanimator.physics.loading import resolve
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.system import System
from neuroanimator.terminal import progress_bar

WORKPLACE = Path("out/dm_control")
RESULTS = Path(__file__).with_name("dm_control_suite.csv")

EPISODES = 20
FIRST_SEED = 0

HORIZON = 60
"""Super steps a plan looks ahead. What is wanted is wanted in the second half of them: there is a way to go."""

KNOTS = 30
"""Of the splines a plan is made of: smooth controls, and half of the numbers."""

GUESSES = 64
"""Controls tried at every plan, half of them random, half waves."""

ITERATIONS = 2
"""Backward sweeps a plan."""

EFFORT = 0.01
"""Weight of effort: hardly any, for the rewards have none, or little."""


@dataclass(frozen=True)
class DmTask:
    """A task of the suite, and what is asked for in it."""

    domain: str
    task: str
    model: Callable[[Any], tuple[str, dict[str, bytes]]]
    """The suite → its MJCF and the files that needs."""
    costs: Callable[[System, Any, float], list[Any]]
    """(system, physics, since when [s] in a plan) → cost terms, by the words of the reward."""


def fish_costs(system: System, physics: Any, since: float) -> list[Any]:
    """Mouth in the target (seven eighths of the reward), torso upright (the last)."""
    mouth = physics.named.model.geom_pos["mouth"]
    radii = physics.named.model.geom_size[["mouth", "target"], 0].sum()
    target = physics.named.model.geom_pos["target"]
    at_target = na.reach_point(
        system, "torso", target, offset=mouth, within=float(radii), since=since
    )
    return [at_target, na.stay_upright(system, tolerance=0.1, within=0.5, weight=0.1)]


def swimmer_costs(system: System, physics: Any, since: float) -> list[Any]:
    """Nose in the target, seen from above."""
    nose = physics.named.model.geom_pos["nose"]
    radius = physics.named.model.geom_size["target", 0]
    target = physics.named.model.geom_pos["target"][:2]
    return [
        na.reach_point(
            system, "head", target, offset=nose, axes="xy", within=float(radius), since=since
        )
    ]


def cartpole_costs(system: System, physics: Any, since: float) -> list[Any]:
    """Pole up, cart in the middle, both still."""
    wanted = {"slider": [0.0], "hinge_1": [0.0], "hinge_1.velocity": [0.0]}
    within = {"slider": 3.0, "hinge_1": 1.0, "hinge_1.velocity": 10.0}
    return [na.reach_state(system, wanted, within=within, since=since)]


TASKS = {
    "fish-swim": DmTask(
        "fish", "swim", lambda suite: suite.fish.get_model_and_assets(), fish_costs
    ),
    "swimmer-swimmer6": DmTask(
        "swimmer",
        "swimmer6",
        lambda suite: suite.swimmer.get_model_and_assets(6),
        swimmer_costs,
    ),
    "cartpole-swingup": DmTask(
        "cartpole",
        "swingup",
        lambda suite: suite.cartpole.get_model_and_assets(num_poles=1),
        cartpole_costs,
    ),
}


def emulator_of(name: str, task: DmTask, suite: Any) -> tuple[na.Emulator, int]:
    """Return the emulator of a task's model, made by defaults, and how many of its super steps were simulated.

    Its super step is the one proposed, but a whole number of the task's control steps.
    """
    folder = WORKPLACE / name
    path = folder / f"{name}.emulator.safetensors"
    toml = write_model(name, task, suite, folder)
    environment = suite.load(task.domain, task.task)
    own_step = environment.control_timestep()
    system, definition, substeps = resolve(str(toml))
    physics_dt = environment.physics.timestep()
    held = max(1, int(substeps * physics_dt / own_step + 1e-9))
    config = na.DatasetConfig(
        system=system,
        definition=definition,
        substeps=round(held * own_step / physics_dt),
    )
    if not path.exists():
        with progress_bar(f"{name}: simulating", config.shards) as bar:
            na.generate(config, folder / "data", on_shard=bar.advance)
        training = na.TrainingConfig()
        with progress_bar(f"{name}: training", training.updates) as bar:
            data = na.read_transitions(folder / "data")
            na.train(data, training, path, on_report=lambda report: bar.advance_to(report.update))
    return na.load_emulator(path), config.runs * RUN_STEPS * held


def write_model(name: str, task: DmTask, suite: Any, folder: Path) -> Path:
    """Write the task's MJCF and what it includes, and what `new` makes of it; return the TOML file."""
    toml = folder / f"{name.replace('-', '_')}.toml"
    if toml.exists():
        return toml
    text, assets = task.model(suite)
    for asset, content in assets.items():
        path = folder / asset
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    source = toml.with_suffix(".xml")
    source.write_bytes(text if isinstance(text, bytes) else text.encode())
    write_definition(str(source), toml)
    return toml


def row_of(name: str, suite: Any, episodes: int) -> dict[str, Any]:
    """Return what the planner, idleness and random actions collect in the same episodes."""
    task = TASKS[name]
    emulator, learnt_from = emulator_of(name, task, suite)
    test = held_out_runs(emulator)
    planner = planner_of(task, emulator, suite)
    planned = []
    idle = []
    random = []
    with progress_bar(f"{name}: episodes", episodes) as bar:
        for seed in range(FIRST_SEED, FIRST_SEED + episodes):
            world = control.DmEnvironment(suite.load(task.domain, task.task, {"random": seed}))
            episode = control.control_environment(
                planner,
                world,
                sys.maxsize,
                objective_of=lambda w, _: objective_of(task, emulator, test.system, w),
            )
            planned.append(episode.total_reward)
            idle.append(return_of(suite, task, seed, lambda rng, spec: np.zeros(spec.shape)))
            random.append(return_of(suite, task, seed, as_it_comes))
            bar.advance_to(len(planned), f"mean return {np.mean(planned):.0f}")
    return {
        "task": name,
        "mean_return": float(np.mean(planned)),
        "least": min(planned),
        "largest": max(planned),
        "idle": float(np.mean(idle)),
        "random": float(np.mean(random)),
        "episodes": episodes,
        "one_step_error": float(root_mean_square(one_step_error(emulator, test))),
        "super_step_s": emulator.dt,
        "learnt_from_control_steps": learnt_from,
    }


def planner_of(task: DmTask, emulator: na.Emulator, suite: Any) -> control.Planner:
    """Return the planner of a task; its targets change with every episode."""
    world = control.DmEnvironment(suite.load(task.domain, task.task))
    world.reset()
    return control.Planner.of(
        emulator,
        objective_of(task, emulator, system_of(emulator), world),
        HORIZON,
        iterations=ITERATIONS,
        guesses=GUESSES,
        parametrisation=control.Spline.of(HORIZON, KNOTS, emulator.bounds),
    )


def objective_of(task: DmTask, emulator: na.Emulator, system: System, world: Any) -> na.Objective:
    """Return what is asked for in the episode that has just begun."""
    since = HORIZON * emulator.dt / 2
    costs = task.costs(system, world.unwrapped.physics, since)
    return na.Objective.of(na.effort(EFFORT), *costs)


def as_it_comes(rng: np.random.Generator, spec: Any) -> np.ndarray:
    """Return a random action, evenly distributed."""
    return rng.uniform(spec.minimum, spec.maximum)


def return_of(
    suite: Any,
    task: DmTask,
    seed: int,
    act: Callable[[np.random.Generator, Any], np.ndarray],
) -> float:
    """Return what an episode yields to actions that look at nothing."""
    world = suite.load(task.domain, task.task, {"random": seed})
    rng = np.random.default_rng(seed)
    moment = world.reset()
    total = 0.0
    while not moment.last():
        moment = world.step(act(rng, world.action_spec()))
        total += moment.reward
    return total


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("task", nargs="?", choices=list(TASKS), help="one of them; all if left out")
    parser.add_argument("--episodes", type=int, default=EPISODES, help="fewer; writes no file")
    options = parser.parse_args()
    try:
        from dm_control import suite
    except ImportError:
        sys.exit('dm_control is missing: pip install "dm_control<1.0.50"')
    names = [options.task] if options.task else list(TASKS)
    rows = [row_of(name, suite, options.episodes) for name in names]
    show_rows(rows)
    if not options.task and options.episodes == EPISODES:
        keep_rows(RESULTS, rows, options)


if __name__ == "__main__":
    main()
