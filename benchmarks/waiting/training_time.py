"""How long a training by the defaults takes, and the error it ends with, beside another tree's: before and after.

python -m benchmarks.waiting.training_time --src OTHER/src pendulum truck Hopper-v5   in turn with this tree

Both trees train on the same windows and are judged on the same ones. Each training is a process of its own with an empty cache,
so that compiling counts. The machine should be idle.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

import neuroanimator as na
from benchmarks.harness import PROGRAM, ROOT, Clocks, Rows, keep_rows, parser_of, show_rows
from neuroanimator.physics.loading import resolve
from neuroanimator.terminal import phase

RESULTS = Path(__file__).with_name("training_time.csv")

TRAIN = """
import json, sys
from pathlib import Path
import numpy as np
import neuroanimator as na
try:
    from neuroanimator.learn.data.store import Transitions
    from neuroanimator.physics.loading import resolve
except ImportError:
    from neuroanimator.data.store import Transitions
    from neuroanimator.systems.loading import resolve
reference, windows, out, seed, updates, share = sys.argv[1:]
name, definition, substeps = resolve(reference)
config = na.DatasetConfig(system=name, definition=definition, substeps=substeps)
data = Transitions(config, na.load_system(reference), diverged=0, **np.load(windows))
settings = na.TrainingConfig.usual(data.system.structure, seed=int(seed))
count = round((int(updates) or settings.updates) * float(share))
settings = settings.model_copy(update={"updates": count})
reports = []
na.train(data, settings, Path(out) / "own.emulator.safetensors", on_report=reports.append)
print(json.dumps([count, reports[-1].error, reports[-1].unrolled_error]))
"""
"""Program that trains an emulator and prints (number of updates, error, unrolled error), those of the last validation."""


class Case(NamedTuple):
    """A system, and the data of which its emulators are trained."""

    reference: str
    """Shipped system, or Gymnasium environment."""
    transitions: int
    updates: tuple[int, int] = (0, 0)
    """Number of updates of the other tree, and of this one to about the same error; 0 for the defaults."""


CASES = {
    "demo": Case("pendulum", 100_000, (100_000, 12_000)),
    "pendulum": Case("pendulum", 100_000),
    "fish": Case("fish", 100_000),
    "truck": Case("truck", 100_000, (40_000, 3_500)),
    "Hopper-v5": Case("Hopper-v5", 150_000, (16_000, 6_000)),
    "Ant-v5": Case("Ant-v5", 150_000),
    "cape": Case("cape", 12_288),
}


def main() -> None:
    """Train in both trees, in turn."""
    parser = parser_of(__doc__)
    parser.add_argument("names", nargs="+", choices=list(CASES))
    parser.add_argument("--src", type=Path, required=True, help="source folder of the other tree")
    parser.add_argument("--seeds", type=int, default=3, help="number of trainings of each tree")
    parser.add_argument("--share", type=float, default=1.0, help="share of the updates of both")
    options = parser.parse_args()
    rows: Rows = []
    for name in options.names:
        with TemporaryDirectory() as folder:
            rows += trainings(name, Path(folder), options)
    show_rows(rows)
    keep_rows(RESULTS, rows, options, "case", "tree", "seed", "share")


def trainings(name: str, folder: Path, options: argparse.Namespace) -> Rows:
    """Return a row for each training of a case, whose files lie in `folder`."""
    case = CASES[name]
    reference, windows = written(case, folder)
    trees = {"before": options.src.resolve(), "after": ROOT / "src"}
    rows = []
    for seed in range(options.seeds):
        for (tree, source), updates in zip(trees.items(), case.updates, strict=True):
            with phase(f"{name}, {tree}, seed {seed}"):
                told = trained(
                    source, reference, windows, str(seed), str(updates), str(options.share)
                )
            rows.append({"case": name, "tree": tree, "seed": seed, "share": options.share} | told)
    return rows


def written(case: Case, folder: Path) -> tuple[str, Path]:
    """Return (reference of the case's system, file of its windows), made in `folder`."""
    reference = case.reference
    if reference.endswith("-v5"):
        subprocess.run(
            [PROGRAM, "new", reference, "--out", "own.toml"],
            cwd=folder,
            check=True,
            stdout=subprocess.DEVNULL,
        )
        reference = str(folder / "own.toml")
    name, definition, substeps = resolve(reference)
    config = na.DatasetConfig(
        system=name, definition=definition, substeps=substeps, count=case.transitions
    )
    with phase(f"simulating {name}"):
        na.generate(config, folder / "data")
    data = na.read_transitions(folder / "data")
    windows = folder / "windows.npz"
    np.savez(windows, states=data.states, controls=data.controls, run=data.run)
    return reference, windows


def trained(source: Path, reference: str, windows: Path, *settings: str) -> dict[str, float]:
    """Return what one training of a tree took, and the errors it ended with."""
    began = Clocks.now()
    with TemporaryDirectory() as folder:
        ran = subprocess.run(
            [sys.executable, "-P", "-c", TRAIN, reference, windows, folder, *settings],
            env=os.environ | {"PYTHONPATH": str(source), "XDG_CACHE_HOME": folder},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    took = began.passed()
    updates, error, unrolled_error = json.loads(ran.stdout.splitlines()[-1])
    return {
        "updates": updates,
        "seconds": took.seconds,
        "cpu_seconds": took.cpu_seconds,
        "error": error,
        "unrolled_error": unrolled_error,
    }


if __name__ == "__main__":
    main()
