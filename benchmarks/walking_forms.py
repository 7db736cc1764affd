"""Likelihoods, slopes, and both together, compared on policies that learn to walk.

python benchmarks/walking_forms.py                          Walker2d-v5, two seeds
python benchmarks/walking_forms.py Hopper-v5 --seeds 1 --dry
python benchmarks/walking_forms.py human --seeds 1 --updates 120     a human who learns to follow a recorded walk

Each run takes the same number of updates, hence of steps of the environment, from the same emulator and seed: with likelihoods
alone (proximal policy optimisation), with an emulator's gradients alone ("slopes"), and with both, weighted for the least
expected error. Curves are means of sixteen episodes on MuJoCo without noise; time is the time of learning.

Writes results/walking_forms.csv.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from human_clips import HUMAN
from walking import keep, prepared

import neuroanimator as na
from neuroanimator.cli.policy import first_emulator
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.gym.policy_task import FOR_SLOPES, PolicyTask, task_to_learn
from neuroanimator.systems import load_system
from neuroanimator.systems.loading import resolve
from neuroanimator.systems.system import System
from neuroanimator.terminal import print_table

FORMS = {"likelihoods": 0.0, "slopes": 1.0, "both": None}
"""Weight of slopes in each form; None: chosen in every update."""

UPDATES = 160

REPORTS = 8

FIRST_SEED = 100


def curves(env_id: str, seed: int, updates: int) -> list[dict[str, Any]]:
    """Return the learning curves of all forms, as rows."""
    rows: list[dict[str, Any]] = []
    with TemporaryDirectory() as place:
        if env_id == "human":
            system, task, leaps = prepared_human(Path(place), seed)
        else:
            system, task, leaps = prepared(env_id, Path(place), seed)
        for form, weight in FORMS.items():
            learning = replace(
                task.learning, updates=updates, reports=REPORTS, seed=seed, gradient_weight=weight
            )
            told: list[Any] = []
            na.learn_policy(
                system, leaps, task.rules, learning, reference=task.motion, on_report=told.append
            )
            rows += [
                {"environment": env_id, "seed": seed, "form": form} | report._asdict()
                for report in told
            ]
    return rows


def prepared_human(folder: Path, seed: int) -> tuple[System, PolicyTask, Emulator]:
    """Return (the human's physics, the task of following his walk, an emulator of it as robots begin with)."""
    toml = HUMAN / "human.toml"
    name, definition, _ = resolve(str(toml))
    system = load_system(str(toml))
    task = task_to_learn(definition, toml, system)._replace(emulator=FOR_SLOPES)
    return system, task, first_emulator(name, definition, task, folder / "run", seed)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("environments", nargs="*", default=["Walker2d-v5"])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--updates", type=int, default=UPDATES)
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    print(describe_machine())
    rows = []
    for env_id in arguments.environments:
        for seed in range(FIRST_SEED, FIRST_SEED + arguments.seeds):
            rows += curves(env_id, seed, arguments.updates)
            print_table(rows)
            if not arguments.dry:
                keep("walking_forms.csv", rows)


if __name__ == "__main__":
    main()
