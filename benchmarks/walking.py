"""Policies for locomotion, learnt on MuJoCo with an emulator's gradients: returns over time and steps.

python benchmarks/walking.py                                 five seeds of each; see MINUTES
python benchmarks/walking.py Walker2d-v5 --seeds 0 --minutes 2 --dry

Each run calls `neuroanimator new`, `policy` and `evaluate` from scratch, which includes training the emulator. Returns are of
whole episodes of Gymnasium's own environment, without noise: mean, minimum and maximum of 100, and the mean inside the
emulator. Returns during learning are of sixteen episodes on MuJoCo. Runs are limited by wall-clock time: other work on the
machine means fewer steps.

Writes results/walking.csv and results/walking_curves.csv.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from neuroanimator.cli.policy import first_emulator
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.csv_table import merge_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.gym.policy_task import PolicyTask, task_to_learn
from neuroanimator.systems import load_system
from neuroanimator.systems.loading import resolve, trust_files
from neuroanimator.systems.system import System
from neuroanimator.terminal import print_table

Rows = list[dict[str, Any]]

RESULTS = Path(__file__).parent / "results"

PROGRAM = Path(sys.executable).parent / "neuroanimator"

MINUTES = {"Walker2d-v5": 5.0, "Hopper-v5": 3.0, "Ant-v5": 9.0}
"""Time from `new` to the policy's file [min]."""

EPISODES = 100

FIRST_SEED = {"Walker2d-v5": 100, "Hopper-v5": 100, "Ant-v5": 102}
"""First seed per environment: settings were chosen on lower ones."""

SEEDS = 5
"""Number of seeds from the first on."""


def learnt(env_id: str, seed: int, minutes: float) -> tuple[dict[str, Any], Rows]:
    """Return (a row of results of one policy, rows of its learning curve)."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        began = time.monotonic()
        run(folder, "new", env_id)
        left = minutes - (time.monotonic() - began) / 60
        file = "run.policy.safetensors"
        run(folder, "policy", f"{env_id}.toml", "--seed", seed, "--minutes", left, "--out", file)
        seconds = time.monotonic() - began
        told = run(
            folder, "evaluate", file, "--system", f"{env_id}.toml", "--episodes", EPISODES, "--json"
        )
        curve = (folder / "run.policy.run" / "metrics.jsonl").read_text().splitlines()
    found = json.loads(told)
    row = {"environment": env_id, "seed": seed, "seconds": seconds} | found
    points = [json.loads(line) for line in curve]
    row["steps"] = points[-1]["steps"]
    return row, [{"environment": env_id, "seed": seed} | point for point in points]


def prepared(env_id: str, folder: Path, seed: int) -> tuple[System, PolicyTask, Emulator]:
    """Return (the physics of a task, the task, its initial emulator), as in `neuroanimator policy`."""
    run(folder, "new", env_id)
    toml = folder / f"{env_id}.toml"
    name, definition, _ = resolve(str(toml))
    trust_files(toml)
    system = load_system(str(toml))
    task = task_to_learn(definition, toml, system)
    return system, task, first_emulator(name, definition, task, folder / "run", seed)


def keep(file: str, rows: Rows) -> None:
    """Write rows into a table, replacing those of the same environments and seeds."""
    merge_csv(RESULTS / file, rows, "environment", "seed")


def run(folder: Path, *arguments: object) -> str:
    """Return the output of a `neuroanimator` command."""
    command = [str(PROGRAM), *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("environments", nargs="*", default=list(MINUTES))
    parser.add_argument("--seeds", type=int, nargs="+", help="default: those of the table")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    print(describe_machine())
    rows: Rows = []
    curves: Rows = []
    for env_id in arguments.environments:
        first = FIRST_SEED.get(env_id, 0)
        for seed in arguments.seeds or range(first, first + SEEDS):
            minutes = arguments.minutes or MINUTES.get(env_id, 10.0)
            row, curve = learnt(env_id, seed, minutes)
            rows.append(row)
            curves += curve
            print_table([row])
            if not arguments.dry:
                keep("walking.csv", rows)
                keep("walking_curves.csv", curves)


if __name__ == "__main__":
    main()
