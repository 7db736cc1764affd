"""Policies for locomotion, learnt on MuJoCo with an emulator's gradients: returns over time and steps.

python -m benchmarks.walking.walking                                                    five seeds of each; see MINUTES
python -m benchmarks.walking.walking Walker2d-v5 --seeds 0 --minutes 2 --dry
taskset -c 0 python -m benchmarks.walking.walking Walker2d-v5 --seeds 100 --minutes 60  an hour of one core, as for the peers
python -m benchmarks.walking.walking --draw                                             docs/images/walking.png, from the tables

Each run calls `neuroanimator new`, `policy` and `evaluate` from scratch, which includes training the emulator. Returns are of
whole episodes of Gymnasium's own environment, without noise: mean, minimum and maximum of 100, and the mean inside the
emulator. Returns during learning are of sixteen episodes on MuJoCo. Runs are limited by wall-clock time: other work on the
machine means fewer steps.

Writes walking.csv and walking_curves.csv.
"""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from benchmarks.harness import IMAGES, PROGRAM, Rows, keep_rows, parser_of, read_rows, show_rows
from neuroanimator.cli.policy import first_emulator
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.gym.policy_task import PolicyTask, task_to_learn
from neuroanimator.physics import load_system
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.systems.system import System

RESULTS = Path(__file__).parent

MINUTES = {"Walker2d-v5": 5.0, "Hopper-v5": 3.0, "Ant-v5": 9.0}
"""Time from `new` to the policy's file [min]."""

EPISODES = 100

FIRST_SEED = {"Walker2d-v5": 100, "Hopper-v5": 100, "Ant-v5": 102}
"""First seed per environment: settings were chosen on lower ones."""

PICTURE = IMAGES / "walking.png"

OURS = "NeuroAnimator"

PEERS = {"PPO": "#2b5a94", "SAC": "#4fa3a0"}
"""Colours of the peers' curves."""

RUN = ("environment", "seed", "minutes")
"""Columns that tell a run."""

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
    run_of = {"environment": env_id, "seed": seed, "minutes": minutes}
    points = [json.loads(line) for line in curve]
    row = run_of | {"seconds": seconds} | found | {"steps": points[-1]["steps"]}
    return row, [run_of | point for point in points]


def prepared(env_id: str, folder: Path, seed: int) -> tuple[System, PolicyTask, Emulator]:
    """Return (the physics of a task, the task, its initial emulator), as in `neuroanimator policy`."""
    run(folder, "new", env_id)
    toml = folder / f"{env_id}.toml"
    name, definition, _ = resolve(str(toml))
    trust_files(toml)
    system = load_system(str(toml))
    task = task_to_learn(definition, toml, system)
    return system, task, first_emulator(name, definition, task, folder / "run", seed)


def draw(path: Path) -> None:
    """Draw returns during learning over minutes and over steps, ours and those of walking_peers.py.

    Minutes are wall clock of two cores for ours, of one core for its run of an hour, and a core's time for the others.
    """
    figure = Figure(figsize=(10.0, 5.6), layout="constrained")
    grid = figure.subplots(2, len(MINUTES), sharey="col")
    ours = read_rows(RESULTS / "walking_curves.csv")
    theirs = read_rows(RESULTS / "walking_peers_curves.csv")
    longest = {
        (row["environment"], row["algorithm"]): row["minutes"]
        for row in sorted(theirs, key=lambda row: float(row["minutes"]))
    }
    for column, env_id in enumerate(MINUTES):
        runs = {(row["seed"], row["minutes"]) for row in ours if row["environment"] == env_id}
        curves = [
            (OURS, "#e8892b", _rows_with(ours, environment=env_id, seed=seed, minutes=minutes))
            for seed, minutes in sorted(runs)
        ]
        for algorithm, colour in PEERS.items():
            minutes = longest.get((env_id, algorithm), "")
            found = _rows_with(theirs, environment=env_id, algorithm=algorithm, minutes=minutes)
            curves.append((algorithm, colour, found))
        for axes, quantity, scale in zip(
            grid[:, column], ("seconds", "steps"), (60.0, 1e6), strict=True
        ):
            for label, colour, rows in curves:
                if not rows:
                    continue
                across = [float(row[quantity]) / scale for row in rows]
                up = [float(row["mean_return"]) for row in rows]
                axes.plot(across, up, color=colour, alpha=0.8, linewidth=1.3, label=label)
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.grid(which="major", alpha=0.2)
        grid[0, column].set_title(env_id)
        grid[0, column].set_xlabel("minutes")
        grid[1, column].set_xlabel("million steps of the environment")
    for row in grid:
        row[0].set_ylabel("mean return")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=len(named))
    figure.savefig(path, dpi=110)


def _rows_with(rows: list[dict[str, str]], **cells: str) -> list[dict[str, str]]:
    return [row for row in rows if all(row[key] == cell for key, cell in cells.items())]


def run(folder: Path, *arguments: object) -> str:
    """Return the output of a `neuroanimator` command."""
    command = [str(PROGRAM), *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("environments", nargs="*", default=list(MINUTES))
    parser.add_argument("--seeds", type=int, nargs="+", help="default: those of the table")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--draw", action="store_true", help="draw the tables instead")
    arguments = parser.parse_args()
    if arguments.draw:
        draw(PICTURE)
        return
    rows: Rows = []
    curves: Rows = []
    for env_id in arguments.environments:
        first = FIRST_SEED.get(env_id, 0)
        for seed in arguments.seeds or range(first, first + SEEDS):
            minutes = arguments.minutes or MINUTES.get(env_id, 10.0)
            row, curve = learnt(env_id, seed, minutes)
            rows.append(row)
            curves += curve
            show_rows([row])
            keep_rows(RESULTS / "walking.csv", rows, arguments, *RUN)
            keep_rows(RESULTS / "walking_curves.csv", curves, arguments, *RUN)


if __name__ == "__main__":
    main()
