"""Make the emulators that ship in the package, by their recipes.

python benchmarks/train_shipped.py                    every one, about two hours on 2 cores
python benchmarks/train_shipped.py pendulum 50        one of them
python benchmarks/train_shipped.py pendulum 50 large  the same in its large size
python benchmarks/train_shipped.py trust              what those that ship know, measured again by runs they never saw
"""

from __future__ import annotations

import sys
from pathlib import Path

from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.emulator.artifact import load, read_metadata, save
from neuroanimator.training.recipes import LARGE_RECIPES, RECIPES, cook
from neuroanimator.training.trust_fitting import fit_trust
from neuroanimator.zoo import LARGE, SHIPPED, shipped_path

WORKPLACE = Path("out/shipped")

UNSEEN = {"count": 14_400, "samples_per_run": 36, "seed": 1}
"""What meters are fitted to: a small dataset as they were trained on, of another seed."""


def fit_shipped(system: str, substeps: int, size: str) -> None:
    """Give the emulator that ships the meter of what it knows; nothing else of its file changes."""
    path = shipped_path(system, substeps, size)
    recipe = (LARGE_RECIPES if size else RECIPES)[system]
    config = DatasetConfig(**{**recipe.data(system, substeps).model_dump(), **UNSEEN})
    fitted = fit_trust(load(path), simulate_transitions(config))
    save(fitted, path, read_metadata(path)["provenance"])
    print(path.name)


def make_shipped(system: str, substeps: int, size: str) -> None:
    """Train the emulator that ships by its recipe."""
    _, made = cook(system, substeps, WORKPLACE, size=size, on_report=print)
    shipped_path(system, substeps, size).write_bytes(made.read_bytes())


if __name__ == "__main__":
    usual = [(system, substeps, "") for system, substeps in SHIPPED]
    large = [(system, substeps, "large") for system, substeps in LARGE]
    chosen = usual + large
    if len(sys.argv) > 2:
        chosen = [(sys.argv[1], int(sys.argv[2]), "".join(sys.argv[3:]))]
    for one in chosen:
        fit_shipped(*one) if sys.argv[1:] == ["trust"] else make_shipped(*one)
