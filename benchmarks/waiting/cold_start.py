"""Seconds from command to result, each in a process of its own, with nothing compiled and with everything cached.

Also the CPU time of all processes, which other work on the machine affects less.

python -m benchmarks.waiting.cold_start                  this tree: a table, and cold_start.csv
python -m benchmarks.waiting.cold_start --src OTHER/src  and another tree, in turn with this one: before and after

Every tree has a cache folder of its own, which is emptied before a cold run. A tree without a cache is as
slow warm as cold. The machine should be idle.
"""

from __future__ import annotations

import itertools
import math
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.harness import ROOT, Clocks, Rows, keep_rows, parser_of, show_rows
from neuroanimator.terminal import progress_bar

HERE = ROOT / "src"
"""This source tree."""

RESULTS = Path(__file__).with_name("cold_start.csv")
"""The table is written to this file unless --out says otherwise."""

ROUNDS = 3
"""Number of timings of every task; the least counts."""

PATIENCE = 600
"""Maximum time of a run [s]."""

STATES = ("cold", "warm")
"""The states of the cache a task is timed in: emptied, and left by the run before."""

MAX_SHOWN = 300
"""Number of last characters shown of what a failed run said."""

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
"""Program that prints how long the last of a number of calls took [s]."""

RUN_VERB = "from neuroanimator.cli.main import main; main()"
"""The program that runs a verb of the command line."""

VERBS = {
    "animate fish": ("animate", "fish", "--out", "fish.csv"),
    "animate fish, GLB": ("animate", "fish", "--out", "fish.glb"),
    "animate fish, film": ("animate", "fish", "--out", "fish.mp4"),
    "export fish, header": ("export", "fish-50", "--out", "fish.h"),
    "control lander": ("control", "lander", "--goal", "pad", "--out", "landing.csv"),
    "control pendulum": ("control", "pendulum", "--out", "swing.csv"),
}
"""The tasks that are verbs of the command line, with their arguments."""

CALLS = {"first Emulator.step": 1, "hundredth Emulator.step": 100}
"""The tasks that are calls of the fish's emulator; the first as the whole process sees it, imports and loading included."""


@dataclass(frozen=True)
class Tree:
    """A source tree to be timed, and its cache."""

    name: str
    """What the table calls the tree."""
    source: Path
    """Its src folder."""
    cache: Path
    """The cache folder of its processes."""

    def environment(self) -> dict[str, str]:
        """Return what its processes see: its own code and cache, whatever this process was started with."""
        environment = dict(os.environ)
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        environment.pop("NEUROANIMATOR_CACHE", None)
        environment["PYTHONPATH"] = str(self.source)
        environment["XDG_CACHE_HOME"] = str(self.cache)
        return environment

    def forget(self) -> None:
        """Empty the cache."""
        shutil.rmtree(self.cache, ignore_errors=True)


@dataclass(frozen=True)
class Duration:
    """How long a task took."""

    wall: float
    """[s]"""
    cpu: float
    """Of the process and those it started [s]."""


def duration_of(tree: Tree, task: str, folder: Path) -> Duration:
    """Return how long `task` takes."""
    command = [sys.executable, "-c"]
    if task in CALLS:
        command += [STEPS, str(CALLS[task])]
    else:
        command += [RUN_VERB, *VERBS[task]]
    began = Clocks.now()
    done = subprocess.run(
        command,
        cwd=folder,
        env=tree.environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    wall, cpu = began.passed()
    if done.returncode:
        raise SystemExit(f"{tree.name}: {task}: {done.stderr.strip()[-MAX_SHOWN:]}")
    is_later_call = CALLS.get(task, 1) > 1
    if is_later_call:
        wall = float(done.stdout)
    return Duration(wall, cpu)


def rows_of(trees: list[Tree], tasks: list[str], rounds: int, folder: Path) -> Rows:
    """Return for every task the least time of each tree, cold and warm; the trees take turns."""
    rows: Rows = []
    with progress_bar("runs", len(tasks) * rounds * len(trees) * len(STATES)) as bar:
        done = 0
        for task in tasks:
            least: dict[str, float] = {}  # by column, in the table's order
            for state, tree in itertools.product(STATES, trees):
                least[column_of(tree, state, "s")] = math.inf
                least[column_of(tree, state, "CPU s")] = math.inf
            for _, tree in itertools.product(range(rounds), trees):
                tree.forget()
                for state in STATES:
                    duration = duration_of(tree, task, folder)
                    wall = column_of(tree, state, "s")
                    cpu = column_of(tree, state, "CPU s")
                    least[wall] = min(duration.wall, least[wall])
                    least[cpu] = min(duration.cpu, least[cpu])
                    done += 1
                    bar.advance_to(done, f"{tree.name}: {task}, {state}: {duration.wall:.3g} s")
            row: dict[str, object] = {"task": task}
            row.update(least)
            rows.append(row)
    return rows


def column_of(tree: Tree, state: str, unit: str) -> str:
    """Return the name of the table's column of a tree, `cold` or `warm`, in seconds or seconds of CPU time."""
    return f"{tree.name}, {state} {unit}"


def main() -> None:
    """Time the trees, print the table and write it."""
    parser = parser_of(__doc__)
    parser.add_argument("--src", type=Path, help="another tree's src folder: 'before'")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument(
        "--tasks", nargs="*", default=[*VERBS, *CALLS], help="some of the tasks, by name"
    )
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        trees = [Tree("now", HERE, folder / "cache")]
        if options.src:
            before = Tree("before", options.src.resolve(), folder / "cache-before")
            trees = [before, Tree("after", HERE, folder / "cache")]
        rows = rows_of(trees, options.tasks, options.rounds, folder)
    show_rows(rows)
    keep_rows(options.out, rows, options)


if __name__ == "__main__":
    main()
