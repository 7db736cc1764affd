"""Make the emulators that ship in the package, by their recipes.

python benchmarks/train_shipped.py                    every one, about two hours on 2 cores
python benchmarks/train_shipped.py pendulum 50        one of them
python benchmarks/train_shipped.py pendulum 50 large  the same in its large size
"""

from __future__ import annotations

import sys
from pathlib import Path

from neuroanimator.training.recipes import cook
from neuroanimator.zoo import LARGE, SHIPPED, shipped_path

WORKPLACE = Path("out/shipped")

if __name__ == "__main__":
    usual = [(system, substeps, "") for system, substeps in SHIPPED]
    large = [(system, substeps, "large") for system, substeps in LARGE]
    chosen = usual + large
    if len(sys.argv) > 2:
        chosen = [(sys.argv[1], int(sys.argv[2]), "".join(sys.argv[3:]))]
    for system, substeps, size in chosen:
        _, made = cook(system, substeps, WORKPLACE, size=size, on_report=print)
        shipped_path(system, substeps, size).write_bytes(made.read_bytes())
