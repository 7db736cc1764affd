"""Make the emulators that ship in the package, by their recipes.

python benchmarks/train_shipped.py                    every one, about two hours on 2 cores
python benchmarks/train_shipped.py pendulum 50        one of them
"""

from __future__ import annotations

import sys
from pathlib import Path

from neuroanimator.training.recipes import cook
from neuroanimator.zoo import SHIPPED, shipped_path

WORKPLACE = Path("out/shipped")

if __name__ == "__main__":
    chosen = [(sys.argv[1], int(sys.argv[2]))] if len(sys.argv) > 2 else SHIPPED
    for system, substeps in chosen:
        _, made = cook(system, substeps, WORKPLACE, on_report=print)
        shipped_path(system, substeps).write_bytes(made.read_bytes())
