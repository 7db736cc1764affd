"""PPO inside emulators and on MuJoCo: wall-clock time to a fixed return, and the return outside of a policy learnt inside.

python benchmarks/reinforcement.py                 all tasks, 45 minutes on 2 cores; tables, and results/reinforcement*.csv
python benchmarks/reinforcement.py Swimmer-v5      one of them; its rows of the files are replaced
python benchmarks/reinforcement.py --seeds 1       other seeds than 0 to 2; writes no file
python benchmarks/reinforcement.py --emulators     only makes missing emulators
python benchmarks/reinforcement.py --cpu           counts CPU time, on a machine with other work; writes no file

Needs stable-baselines3: pip install "neuroanimator[gym]" "gymnasium[mujoco]" stable-baselines3. Emulators are kept in
out/reinforcement and used again, with their CPU time beside them.

The same algorithm (PPO of stable-baselines3), the same settings, the same task (rules of episodes), on

- `inside`: an emulator, all rows in one compiled call; episodes end where its score is above `trust_limit`, and further out cost;
- `inside, unguarded`: without that;
- `inside, first emulator`: in the emulator made with defaults, before any policy acted on MuJoCo;
- `MuJoCo`: the physics on both cores by mujoco.rollout, no Python in its loop: more steps per second than any vectorisation of
  the same environment by Gymnasium or stable-baselines3, which are also measured;
- `MuJoCo, Gymnasium`: Gymnasium's environment itself in the faster of stable-baselines3's vectorisations, eight of them: common
  practice. The same settings, with rollouts longer in proportion to the fewer rows;
- `MuJoCo, zoo`: the same with the settings of rl-baselines3-zoo, which suit few environments at a time.

Time is the learner's: the clock stops while policies are judged. A policy is judged by its mean action, in 16 episodes
in its own world and 16 on MuJoCo; the last one in 10 of Gymnasium's environment itself, without this package.
Settings were chosen on seeds 100 and above.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

import neuroanimator as na
from neuroanimator.evaluation.csv_table import merge_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.gym import EmulatorVectorEnv, PhysicsVectorEnv
from neuroanimator.terminal import print_table, progress_bar

try:
    import torch
    from reinforcement_cases.emulators import Made, emulator_for, first_emulator, guarded
    from reinforcement_cases.learning import (
        Learnt,
        Point,
        choose_threads,
        fastest_gymnasium_world,
        gymnasium_world,
        learn,
        rows_world,
        steps_per_second,
    )
    from reinforcement_cases.policies import PlainPolicy, gymnasium_returns, play
    from reinforcement_cases.tasks import TASKS, Learning, LearningTask, with_rows
except ImportError as error:
    sys.exit(
        f'{error.name} is missing: pip install "neuroanimator[gym]" "gymnasium[mujoco]" stable-baselines3'
    )

AT_ONCE = AutoresetMode.SAME_STEP
WORKPLACE = Path("out/reinforcement")
RESULTS = Path(__file__).parent / "results"

SEEDS = (0, 1, 2)
GYMNASIUM_ROWS = 8
"""Environments of Gymnasium's own side by side: stepped one by one, more make nothing faster."""

INSIDE_ARMS = ("inside", "inside, unguarded")

MUJOCO_ARMS = ("MuJoCo", "MuJoCo, Gymnasium", "MuJoCo, zoo")
"""What learning inside is compared with."""

JUDGED = 16
"""Episodes a policy is judged by."""

JUDGED_SEED = 5_000
"""Starts of judged episodes, which nobody learns from."""

EPISODES = 10
"""Number of episodes of Gymnasium's environment in which the last policy of each arm is judged."""

SHOWN = (
    "task",
    "arm",
    "seed",
    "arrived",
    "seconds",
    "samples",
    "own_return",
    "mujoco_return",
    "gymnasium_return",
)
"""Columns that are printed; the file has more."""


class Arm(NamedTuple):
    """One way to learn a task."""

    name: str
    seeds: tuple[int, ...]
    world: Callable[[], Any]
    learning: Learning
    limit: float
    """[s]"""
    inside: na.Emulator | None
    """The emulator learnt in; None on MuJoCo."""
    made: Made | None


def arms_of(task: LearningTask, made: Made, first: na.Emulator | None) -> list[Arm]:
    """Return the ways a task is learnt; `first` is its emulator before any round."""
    emulator = made.emulator
    rules = task.rules(emulator)
    rows = task.learning.rows

    def unguarded(used: na.Emulator) -> Callable[[], Any]:
        return lambda: rows_world(
            EmulatorVectorEnv(used, rows, rules=rules, autoreset_mode=AT_ONCE)
        )

    arms = [
        Arm(
            "inside",
            SEEDS,
            lambda: rows_world(guarded(task, emulator, rows)),
            task.learning,
            task.inside_seconds,
            emulator,
            made,
        ),
        Arm(
            "inside, unguarded",
            SEEDS,
            unguarded(emulator),
            task.learning,
            task.inside_seconds,
            emulator,
            made,
        ),
    ]
    if first is not None:
        arms.append(
            Arm(
                "inside, first emulator",
                SEEDS[:2],
                lambda: rows_world(guarded(task, first, rows)),
                task.learning,
                task.inside_seconds,
                first,
                None,
            )
        )
    arms.append(
        Arm(
            "MuJoCo",
            SEEDS[: task.mujoco_seeds],
            lambda: rows_world(
                PhysicsVectorEnv(emulator, rows, rules=rules, autoreset_mode=AT_ONCE)
            ),
            task.learning,
            task.mujoco_seconds,
            None,
            None,
        )
    )
    if task.is_gymnasium:
        arms.append(
            Arm(
                "MuJoCo, Gymnasium",
                SEEDS[:1],
                lambda: fastest_gymnasium_world(task.name, GYMNASIUM_ROWS),
                with_rows(task.learning, GYMNASIUM_ROWS),
                task.mujoco_seconds,
                None,
                None,
            )
        )
    if task.zoo is not None:
        arms.append(
            Arm(
                "MuJoCo, zoo",
                SEEDS[:1],
                lambda: gymnasium_world(task.name, task.zoo.rows if task.zoo else 1),
                task.zoo,
                task.zoo_seconds,
                None,
                None,
            )
        )
    return arms


def run(
    task: LearningTask, arm: Arm, seed: int, emulator: na.Emulator, clock: Callable[[], float]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the row of an arm and a seed, and its learning curve."""
    rules = task.rules(emulator)
    physics = PhysicsVectorEnv(emulator, JUDGED, rules=rules)
    inside = arm.inside and EmulatorVectorEnv(arm.inside, JUDGED, rules=rules)

    def judge(policy: PlainPolicy) -> tuple[float, float]:
        on_mujoco = float(play(policy, physics, JUDGED_SEED).returns.mean())
        if inside is None:
            return on_mujoco, on_mujoco
        return float(play(policy, inside, JUDGED_SEED).returns.mean()), on_mujoco

    with progress_bar(f"{task.name}: {arm.name}, seed {seed}", round(arm.limit)) as bar:

        def tell(point: Point) -> None:
            said = f"{point.samples} samples, return {point.own_return:.3g}, on MuJoCo {point.mujoco_return:.3g}"
            bar.advance_to(min(round(point.seconds), round(arm.limit)), said)
            if not sys.stderr.isatty():  # where no bar is seen
                print(
                    f"{task.name}: {arm.name}, seed {seed}: {point.seconds:.0f} s, {said}",
                    flush=True,
                )

        learnt = learn(arm.world(), arm.learning, seed, judge, task.target, arm.limit, tell, clock)
    curve = [
        {"task": task.name, "arm": arm.name, "seed": seed, **point._asdict()}
        for point in learnt.points
    ]
    return row_of(task, arm, seed, learnt), curve


def row_of(task: LearningTask, arm: Arm, seed: int, learnt: Learnt) -> dict[str, Any]:
    """Return the result of an arm and a seed."""
    last = learnt.points[-1]
    outside = None
    if task.is_gymnasium:
        seeds = range(JUDGED_SEED, JUDGED_SEED + EPISODES)
        outside = float(np.mean(gymnasium_returns(learnt.policy, task.name, seeds)))
    return {
        "task": task.name,
        "arm": arm.name,
        "seed": seed,
        "target": task.target,
        "arrived": learnt.has_arrived,
        "seconds": last.seconds,
        "samples": last.samples,
        "stepping_share": learnt.stepping_seconds / learnt.seconds,
        "acting_share": learnt.acting_seconds / learnt.seconds,
        "updating_share": learnt.updating_seconds / learnt.seconds,
        "own_return": last.own_return,
        "mujoco_return": last.mujoco_return,
        "gymnasium_return": outside,
        "emulator_seconds": arm.made.seconds if arm.made else None,
        "emulator_environment_steps": arm.made.environment_steps if arm.made else None,
    }


def summary_of(rows: list[dict[str, Any]], curves: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row a task, arm inside and arm on MuJoCo: how much sooner it arrives, and what its policy is worth there."""
    summaries = []
    for name in dict.fromkeys(row["task"] for row in rows):
        of_task = [row for row in rows if row["task"] == name]
        for inside_arm, arm in product(INSIDE_ARMS, MUJOCO_ARMS):
            inside = [row for row in of_task if row["arm"] == inside_arm]
            on_mujoco = [row for row in of_task if row["arm"] == arm]
            if not inside or not on_mujoco:
                continue
            seconds = float(np.median([row["seconds"] for row in inside]))
            made = np.nan_to_num(inside[0]["emulator_seconds"])
            taken = float(np.median([row["seconds"] for row in on_mujoco]))
            then = [
                point["mujoco_return"]
                for point in curves
                if (point["task"], point["arm"]) == (name, arm) and point["seconds"] <= seconds
            ]
            summaries.append(
                {
                    "task": name,
                    "arm": inside_arm,
                    "against": arm,
                    "inside_arrived": f"{sum(row['arrived'] for row in inside)}/{len(inside)}",
                    "arrived": f"{sum(row['arrived'] for row in on_mujoco)}/{len(on_mujoco)}",
                    "inside_seconds": seconds,
                    "seconds": taken,
                    "times_sooner": taken / seconds,
                    "with_emulator": taken / (seconds + float(made)),
                    "inside_on_mujoco": float(np.median([row["mujoco_return"] for row in inside])),
                    "at_equal_time": max(then, default=float("nan")),
                    "target": inside[0]["target"],
                }
            )
    return summaries


def speed_rows(task: LearningTask, emulator: na.Emulator) -> list[dict[str, Any]]:
    """Return how many steps a second each world makes, by random actions, nothing learnt."""
    rules = task.rules(emulator)
    rows = task.learning.rows
    worlds = {
        f"emulator, {rows} rows": lambda: rows_world(
            EmulatorVectorEnv(emulator, rows, rules=rules, autoreset_mode=AT_ONCE)
        ),
        f"mujoco.rollout, {rows} rows": lambda: rows_world(
            PhysicsVectorEnv(emulator, rows, rules=rules, autoreset_mode=AT_ONCE)
        ),
    }
    if task.is_gymnasium:
        worlds["Gymnasium, DummyVecEnv of 8"] = lambda: gymnasium_world(task.name, 8)
        worlds["Gymnasium, SubprocVecEnv of 2"] = lambda: gymnasium_world(task.name, 2, True)
        worlds["Gymnasium, SubprocVecEnv of 8"] = lambda: gymnasium_world(task.name, 8, True)
    made = []
    for name, world in worlds.items():
        made.append(
            {"task": task.name, "world": name, "steps_per_second": steps_per_second(world())}
        )
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", nargs="?", choices=list(TASKS), help="one of them; all if left out")
    parser.add_argument("--arm", help="only this one; writes no file")
    parser.add_argument("--seeds", type=int, nargs="+", help="others; writes no file")
    parser.add_argument("--emulators", action="store_true", help="make what is missing, and end")
    parser.add_argument("--cpu", action="store_true", help="processor time; writes no file")
    options = parser.parse_args()
    threads = 1 if options.cpu else choose_threads()
    torch.set_num_threads(threads)
    print(f"{describe_machine()}, PyTorch on {threads} threads")
    clock = time.process_time if options.cpu else time.perf_counter
    is_whole = not (options.cpu or options.seeds or options.arm)
    for name in [options.task] if options.task else list(TASKS):
        task = TASKS[name]
        made = emulator_for(task, WORKPLACE)
        if options.emulators:
            continue
        speeds = speed_rows(task, made.emulator) if is_whole else []
        rows = []
        curves = []
        for arm in arms_of(task, made, first_emulator(task, WORKPLACE)):
            if options.arm not in (None, arm.name):
                continue
            for seed in options.seeds or arm.seeds:
                row, curve = run(task, arm, seed, made.emulator, clock)
                rows.append(row)
                curves += curve
                print_table([{key: row[key] for key in SHOWN}])
        if is_whole:
            merge_csv(RESULTS / "reinforcement.csv", rows, "task")
            merge_csv(RESULTS / "reinforcement_curves.csv", curves, "task")
            merge_csv(RESULTS / "reinforcement_speed.csv", speeds, "task")
            summaries = summary_of(rows, curves)
            merge_csv(RESULTS / "reinforcement_summary.csv", summaries, "task")
            print_table(speeds)
            print_table(summaries)


if __name__ == "__main__":
    main()
