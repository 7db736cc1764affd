"""Distributions of emulated motions over 10,000 super steps, beside the physics; writes results/drift.csv.

python benchmarks/drift.py                 every emulator of 50 substeps that ships, some minutes on two cores
python benchmarks/drift.py fish-50         some of them; writes no file
python benchmarks/drift.py --quick         1,000 super steps; writes no file

Physics and emulator make 32 motions from the same random starts under the same random controls, as in training.
Distances are between histograms over all of them (total variation). Bounds (90 %) are from leaving out one run after the
other; chance is the distance between two halves of the physics' own runs. See `na.measure_drift`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import neuroanimator as na
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.drift import STEPS
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.terminal import print_table, progress_bar

TABLE = Path(__file__).parent / "results" / "drift.csv"

NAMES = ("pendulum-50", "pendulum-passive-50", "truck-50", "lander-50", "fish-50", "dolphin-50")

QUICK_STEPS = 1_000


def rows_of(name: str, steps: int) -> list[dict[str, Any]]:
    """Return an emulator's lines: one a quantity."""
    emulator = na.load_emulator(name)
    with progress_bar(name, steps) as bar:
        found = na.measure_drift(
            emulator, steps=steps, on_progress=lambda done, _: bar.advance_to(done)
        )
    return [
        {"emulator": name, "super_steps": steps, "seconds": steps * emulator.dt, **drift._asdict()}
        for drift in found
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="EMULATOR")
    parser.add_argument("--quick", action="store_true", help="1,000 super steps; writes no file")
    options = parser.parse_args()
    steps = QUICK_STEPS if options.quick else STEPS
    rows = [row for name in options.names or NAMES for row in rows_of(name, steps)]
    print(describe_machine())
    print_table(rows)
    if not options.names and not options.quick:
        write_csv(TABLE, rows)


if __name__ == "__main__":
    main()
