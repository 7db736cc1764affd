"""Tasks of Gymnasium by planning through an emulator of each one's model, trained with defaults and on its own episodes.

python -m benchmarks.control.gymnasium_tasks               all of them, half an hour on 2 cores; tables, and gymnasium_*.csv
python -m benchmarks.control.gymnasium_tasks Swimmer-v5    one of them
python -m benchmarks.control.gymnasium_tasks --episodes 3  fewer episodes; writes no file

Needs Gymnasium: pip install "neuroanimator[gym]" gymnasium[mujoco]. Emulators are kept in out/gymnasium and used again.

For each: `new` on the environment's name, `generate` and `train` with defaults; rounds of one episode of 1,000 steps each
(seeds 100 on), after each of which `learn_from` trains the emulator on it (none for the hopper: they did not help);
then the episodes for the score, seeds 10 to 19, with the resulting emulator. The constants below and the costs were chosen on
seeds 100 to 109. For comparison: doing nothing and random actions in the same episodes, and published returns of agents.

This is not learning from reward alone. The model is known and may be reset to any state, the whole state is read exactly, and the
objective is written by hand after the reward.
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

WORKPLACE = Path("out/gymnasium")
RESULTS = Path(__file__).parent

EPISODES = 10
FIRST_SEED = 10
FIRST_ROUND_SEED = 100

STEPS = 1000
"""Of the environment, in an episode."""

EFFORT = 0.001
"""Weight of effort: hardly any, for the rewards have hardly any."""


SHOWN = ("task", "what", "mean_return", "least", "largest", "episodes", "learnt_from_steps")
"""Columns that are printed; the file has more."""


@dataclass(frozen=True)
class Published:
    """What others come to, in the environment's returns."""

    agent: str
    mean_return: float
    environment_steps: int
    source: str


@dataclass(frozen=True)
class GymTask:
    """A task, what is asked for in it, and how it is planned."""

    costs: Callable[[System, float], list[Any]]
    """(system, horizon [s]) → cost terms, by the words of the reward."""
    horizon: int
    """Super steps a plan looks ahead."""
    every: int
    """Super steps after which it is planned again."""
    guesses: int
    """Controls tried at every plan, half of them random, half waves."""
    starts: int
    """How many of them are descended from."""
    iterations: int
    """Backward sweeps a plan, at most, by L-BFGS: plans are saturated controls, which Gauss-Newton soon leaves alone."""
    rounds: int
    """Episodes the emulator learns from."""
    published: tuple[Published, ...]


TIANSHOU = "github.com/thu-ml/tianshou, examples/mujoco: ten seeds, best mean within 1M steps, v3"
ZOO = "github.com/DLR-RM/rl-baselines3-zoo, benchmark.md: one tuned run, v3"


def swimmer_costs(system: System, horizon: float) -> list[Any]:
    """Forward along X, as far as possible in the second half of a plan: by its end alone it is put off for ever.

    The joints are kept off their stops at 1.75 rad: there the emulator is at its worst, and plans found that out.
    """
    forward = na.travel(
        system, [1, 0, 0], 0.6 * horizon, within=1.0, body="torso", since=horizon / 2
    )
    keep_off = [
        na.stay_within(system, joint, -1.6, 1.6, within=0.1)
        for joint in ("motor1_rot", "motor2_rot")
    ]
    return [forward, *keep_off]


def hopper_costs(system: System, horizon: float) -> list[Any]:
    """Forward along X as fast as 1.5 m/s in the second half of a plan, well within what the environment calls healthy.

    It ends an episode below 0.7 m and beyond 0.2 rad; at those borders one wrong leap is the last.
    """
    forward = na.travel(
        system, [1, 0, 0], 1.5 * horizon, within=1.0, body="torso", since=horizon / 2
    )
    upright = na.stay_within(system, "rooty", -0.1, 0.1, within=0.02)
    high = na.stay_within(system, "rootz", 1.1, 3.0, within=0.05)
    return [forward, upright, high]


TASKS = {
    "Swimmer-v5": GymTask(
        swimmer_costs,
        horizon=90,
        every=10,
        guesses=1024,
        starts=16,
        iterations=40,
        rounds=5,
        published=(
            Published("SAC", 44.4, 1_000_000, TIANSHOU),
            Published("TD3", 104.2, 1_000_000, TIANSHOU),
            Published("PPO", 281.6, 1_000_000, ZOO),
            Published("SAC", 345.6, 1_000_000, ZOO),
            Published("ARS", 355.3, 2_000_000, ZOO),
        ),
    ),
    "Hopper-v5": GymTask(
        hopper_costs,
        horizon=25,
        every=1,
        guesses=256,
        starts=16,
        iterations=30,
        rounds=0,
        published=(
            Published("SAC", 3542.2, 1_000_000, TIANSHOU),
            Published("TD3", 3472.2, 1_000_000, TIANSHOU),
            Published("SAC", 2325.5, 1_000_000, ZOO),
            Published("PPO", 2410.4, 1_000_000, ZOO),
            Published("A2C", 733.5, 1_000_000, ZOO),
        ),
    ),
}


@dataclass(frozen=True)
class Learnt:
    """An emulator by defaults, what it was made from, and how many steps of the environment that took."""

    emulator: na.Emulator
    data: na.Transitions
    environment_steps: int


def learn_by_defaults(name: str, folder: Path) -> Learnt:
    """Return the emulator of a task by defaults; its super step is the one proposed, but whole steps of the environment."""
    gymnasium = _gymnasium()
    toml = folder / f"{name.split('-')[0].lower()}.toml"
    if not toml.exists():
        write_definition(name, toml)
    world = gymnasium.make(name).unwrapped
    system, definition, substeps = resolve(str(toml))
    frames = world.frame_skip
    held = max(1, substeps // frames)
    config = na.DatasetConfig.usual(system, definition, held * frames)
    path = folder / "round-0.emulator.safetensors"
    if not path.exists():
        with progress_bar(f"{name}: simulating", config.shards) as bar:
            na.generate(config, folder / "data", on_shard=bar.advance)
        data = na.read_transitions(folder / "data")
        training = na.TrainingConfig.usual(data.system.structure)
        with progress_bar(f"{name}: training", training.updates) as bar:
            na.train(data, training, path, on_report=lambda report: bar.advance_to(report.update))
    data = na.read_transitions(folder / "data")
    return Learnt(na.load_emulator(path), data, config.runs * RUN_STEPS * held)


def rows_of(name: str, episodes: int) -> list[dict[str, Any]]:
    """Return a row a round, one of the episodes that count, and one each of idleness, chance and what is published."""
    task = TASKS[name]
    folder = WORKPLACE / name
    folder.mkdir(parents=True, exist_ok=True)
    learnt = learn_by_defaults(name, folder)
    emulator = learnt.emulator
    steps = learnt.environment_steps
    rows = []
    seen = []
    for number in range(task.rounds):
        seeds = [FIRST_ROUND_SEED + number]
        row, episodes_of_round = planned_row(name, f"round {number}", emulator, seeds)
        rows.append({**row, "learnt_from_steps": steps})
        seen += episodes_of_round
        steps += sum(episode.environment_steps for episode in episodes_of_round)
        path = folder / f"round-{number + 1}.emulator.safetensors"
        if not path.exists():
            control.learn_from(emulator, seen, learnt.data).save(path)
        emulator = na.load_emulator(path)
    seeds = range(FIRST_SEED, FIRST_SEED + episodes)
    row, _ = planned_row(name, "planned", emulator, seeds)
    rows.append({**row, "learnt_from_steps": steps})
    rows.append(row_of(name, "idle", [return_of(name, seed, is_idle=True) for seed in seeds]))
    rows.append(row_of(name, "random", [return_of(name, seed, is_idle=False) for seed in seeds]))
    for other in task.published:
        row = row_of(name, f"{other.agent}, published", [other.mean_return])
        rows.append({**row, "learnt_from_steps": other.environment_steps, "source": other.source})
    return rows


def planned_row(
    name: str, what: str, emulator: na.Emulator, seeds: Any
) -> tuple[dict[str, Any], list[control.Episode]]:
    """Return the row of planned episodes, and them."""
    gymnasium = _gymnasium()
    planner = planner_of(TASKS[name], emulator)
    seen = []
    with progress_bar(f"{name}: {what}", len(seeds)) as bar:
        for seed in seeds:
            episode = control.control_environment(
                planner, gymnasium.make(name), STEPS, every=TASKS[name].every, seed=seed
            )
            seen.append(episode)
            returns = [episode.total_reward for episode in seen]
            bar.advance_to(len(seen), f"mean return {np.mean(returns):.0f}")
    error = root_mean_square(one_step_error(emulator, held_out_runs(emulator)))
    row = row_of(name, what, [episode.total_reward for episode in seen])
    return {**row, "one_step_error": float(error), "super_step_s": emulator.dt}, seen


def planner_of(task: GymTask, emulator: na.Emulator) -> control.Planner:
    """Return the planner of a task."""
    costs = task.costs(system_of(emulator), task.horizon * emulator.dt)
    return control.Planner.of(
        emulator,
        na.Objective.of(na.effort(EFFORT), *costs),
        task.horizon,
        method="lbfgs",
        iterations=task.iterations,
        guesses=task.guesses,
        starts=task.starts,
    )


def row_of(name: str, what: str, returns: list[float]) -> dict[str, Any]:
    """Return what a way of acting comes to."""
    return {
        "task": name,
        "what": what,
        "mean_return": float(np.mean(returns)),
        "least": float(min(returns)),
        "largest": float(max(returns)),
        "episodes": len(returns),
        "one_step_error": None,
        "super_step_s": None,
        "learnt_from_steps": None,
        "source": None,
    }


def return_of(name: str, seed: int, *, is_idle: bool) -> float:
    """Return what an episode yields to actions that look at nothing: none, or random ones."""
    world = _gymnasium().make(name)
    world.reset(seed=seed)
    world.action_space.seed(seed)
    total = 0.0
    is_over = False
    while not is_over:
        action = world.action_space.sample()
        _, reward, is_terminated, is_truncated, _ = world.step(action * (not is_idle))
        total += float(reward)
        is_over = is_terminated or is_truncated
    return total


def _gymnasium() -> Any:
    try:
        import gymnasium
    except ImportError:
        sys.exit('gymnasium is missing: pip install "gymnasium[mujoco]"')
    return gymnasium


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("task", nargs="?", choices=list(TASKS), help="one of them; all if left out")
    parser.add_argument("--episodes", type=int, default=EPISODES, help="fewer; writes no file")
    options = parser.parse_args()
    for name in [options.task] if options.task else list(TASKS):
        rows = rows_of(name, options.episodes)
        if options.episodes == EPISODES:
            table = RESULTS / f"gymnasium_{name.split('-')[0].lower()}.csv"
            keep_rows(table, rows, options)
        show_rows(rows, *SHOWN)


if __name__ == "__main__":
    main()
