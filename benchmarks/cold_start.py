"""Seconds from typing to result, each in a process of its own, with nothing compiled and with everything kept.

python benchmarks/cold_start.py                       this tree: a table, and results/cold_start.csv
python benchmarks/cold_start.py --src OTHER/src       and another tree, in turn with this one: before and after

Every tree has a cache folder of its own, which is emptied before a cold run. A tree that keeps nothing is as
slow warm as cold. The machine should be idle.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from neuroanimator.bench.csv_table import write_csv
from neuroanimator.terminal import print_table, progress_bar

HERE = Path(__file__).parents[1] / "src"
RESULTS = Path(__file__).parent / "results" / "cold_start.csv"
ROUNDS = 3
PATIENCE = 600
"""[s] A run may take."""

STEPS = """
import sys, time
import numpy as np
import neuroanimator as na
emulator = na.load_emulator("fish-50")
state = np.array(emulator.rest)
control = np.zeros(emulator.control.size)
for call in range(int(sys.argv[1])):
    began = time.perf_counter()
    np.asarray(emulator.step(state, control))
print(time.perf_counter() - began)
"""
"""Prints how long the last of so many calls took [s]."""

VERBS = {
    "animate fish": ("animate", "fish", "--out", "fish.csv"),
    "animate fish, GLB": ("animate", "fish", "--out", "fish.glb"),
    "animate fish, film": ("animate", "fish", "--out", "fish.mp4"),
    "control lander": ("control", "lander", "--goal", "pad", "--out", "landing.csv"),
    "control pendulum": ("control", "pendulum", "--out", "swing.csv"),
}
CALLS = {"first Emulator.step": 1, "hundredth Emulator.step": 100}
"""Of the fish; the first as the whole process sees it, imports and loading included."""


@dataclass(frozen=True)
class Tree:
    """A source tree to be timed, and its cache."""

    name: str
    source: Path
    cache: Path

    def environment(self) -> dict[str, str]:
        """Return what its processes see: its own code and cache, whatever this process was started with."""
        unwanted = ("JAX_COMPILATION_CACHE_DIR", "NEUROANIMATOR_CACHE")
        given = {key: value for key, value in os.environ.items() if key not in unwanted}
        return given | {"PYTHONPATH": str(self.source), "XDG_CACHE_HOME": str(self.cache)}

    def forget(self) -> None:
        """Empty the cache."""
        shutil.rmtree(self.cache, ignore_errors=True)


def seconds_of(tree: Tree, task: str, folder: Path) -> float:
    """Return how long `task` takes [s]."""
    if task in CALLS:
        command = [sys.executable, "-c", STEPS, str(CALLS[task])]
    else:
        command = [
            sys.executable,
            "-c",
            "from neuroanimator.cli.main import main; main()",
            *VERBS[task],
        ]
    began = time.perf_counter()
    done = subprocess.run(
        command,
        cwd=folder,
        env=tree.environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    took = time.perf_counter() - began
    if done.returncode:
        raise SystemExit(f"{tree.name}: {task}: {done.stderr.strip()[-300:]}")
    return float(done.stdout) if CALLS.get(task, 1) > 1 else took


def rows_of(
    trees: list[Tree], tasks: list[str], rounds: int, folder: Path
) -> list[dict[str, object]]:
    """Return for every task the least time of each tree, cold and warm; the trees take turns."""
    least: dict[tuple[str, str, str], float] = {}
    with progress_bar("runs", len(tasks) * rounds * len(trees) * 2) as bar:
        done = 0
        for task in tasks:
            for _ in range(rounds):
                for tree in trees:
                    tree.forget()
                    for state in ("cold", "warm"):
                        found = seconds_of(tree, task, folder)
                        key = task, tree.name, state
                        least[key] = min(found, least.get(key, found))
                        done += 1
                        bar.advance_to(done, f"{tree.name}: {task}, {state}: {found:.3g} s")
    columns = [(tree.name, state) for state in ("cold", "warm") for tree in trees]
    return [
        {
            "task": task,
            **{f"{name}, {state} s": least[task, name, state] for name, state in columns},
        }
        for task in tasks
    ]


def main() -> None:
    """Time the trees, print the table and write it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--src", type=Path, help="another tree's src folder: 'before'")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument(
        "--tasks", nargs="*", default=[*VERBS, *CALLS], help="some of the tasks, by name"
    )
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args()
    with TemporaryDirectory() as position:
        folder = Path(position)
        trees = [Tree("after" if given.src else "now", HERE, folder / "cache")]
        if given.src:
            trees.insert(0, Tree("before", given.src.resolve(), folder / "cache-before"))
        rows = rows_of(trees, given.tasks, given.rounds, folder)
    print_table(rows)
    write_csv(given.out, rows)


if __name__ == "__main__":
    main()
