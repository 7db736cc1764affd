"""The recipe of the emulators that ship in the package: same data, same seeds, same weights on one machine.

python benchmarks/train_shipped.py                    every one, about two hours on 2 cores
python benchmarks/train_shipped.py pendulum 50        one of them
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from neuroanimator.data.generate import generate
from neuroanimator.data.transitions import dataset_config, read_transitions
from neuroanimator.shipped import SHIPPED, shipped_path
from neuroanimator.training.config import training_config
from neuroanimator.training.train import train

WORKPLACE = Path("out/shipped")


@dataclass(frozen=True)
class Recipe:
    """What one system's emulators are trained on, and for how long."""

    widths: tuple[int, ...]
    transitions: int
    updates: int


RECIPES = {
    "lander": Recipe((64, 48), transitions=300_000, updates=300_000),
    "pendulum": Recipe((96, 64), transitions=300_000, updates=300_000),
    "pendulum-passive": Recipe((64, 64), transitions=300_000, updates=300_000),
    "truck": Recipe((96, 64), transitions=150_000, updates=100_000),
}


def make(system: str, substeps: int) -> None:
    """Train the shipped emulator of `system` at `substeps`, or go on where a killed run stopped."""
    name, recipe = shipped_path(system, substeps).name, RECIPES[system]
    config = dataset_config(system=system, substeps=substeps, count=recipe.transitions, seed=0)
    generate(config, WORKPLACE / f"{system}-{substeps}")
    training = training_config(widths=recipe.widths, updates=recipe.updates)
    train(read_transitions(WORKPLACE / f"{system}-{substeps}"), training, WORKPLACE / name, on_report=print)
    shipped_path(system, substeps).write_bytes((WORKPLACE / name).read_bytes())


if __name__ == "__main__":
    chosen = [(sys.argv[1], int(sys.argv[2]))] if len(sys.argv) > 2 else SHIPPED
    for system, substeps in chosen:
        make(system, substeps)
