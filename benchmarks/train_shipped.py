"""The recipe of the emulators that ship in the package: same data, same seeds, same weights on one machine.

python benchmarks/train_shipped.py                    every one, about 40 minutes on 2 cores
python benchmarks/train_shipped.py pendulum 50        one of them
"""

from __future__ import annotations

import sys
from pathlib import Path

from neuroanimator.data.generate import generate
from neuroanimator.data.transitions import dataset_config, read_transitions
from neuroanimator.shipped import SHIPPED, shipped_path
from neuroanimator.training.config import training_config
from neuroanimator.training.train import train

TRANSITIONS = 300_000
UPDATES = 300_000
WIDTHS = {"pendulum": (96, 64), "pendulum-passive": (64, 64)}
WORKPLACE = Path("out/shipped")


def make(system: str, substeps: int) -> None:
    """Train the shipped emulator of `system` at `substeps`, or go on where a killed run stopped."""
    name = shipped_path(system, substeps).name
    config = dataset_config(system=system, substeps=substeps, count=TRANSITIONS, seed=0)
    generate(config, WORKPLACE / f"{system}-{substeps}")
    training = training_config(widths=WIDTHS[system], updates=UPDATES)
    train(read_transitions(WORKPLACE / f"{system}-{substeps}"), training, WORKPLACE / name, on_report=print)
    shipped_path(system, substeps).write_bytes((WORKPLACE / name).read_bytes())


if __name__ == "__main__":
    chosen = [(sys.argv[1], int(sys.argv[2]))] if len(sys.argv) > 2 else SHIPPED
    for system, substeps in chosen:
        make(system, substeps)
