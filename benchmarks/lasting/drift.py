"""Distributions of emulated motions over 10,000 super steps, beside the physics; writes drift.csv.

python -m benchmarks.lasting.drift          every emulator of 50 substeps that ships, some minutes on two cores
python -m benchmarks.lasting.drift fish-50  some of them; writes no file
python -m benchmarks.lasting.drift --quick  1,000 super steps; writes no file

Physics and emulator make 32 motions from the same random starts under the same random controls, as in training.
Distances are between histograms over all of them (total variation). Bounds (90 %) are from leaving out one run after the
other; chance is the distance between two halves of the physics' own runs. See `na.measure_drift`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import neuroanimator as na
from benchmarks.harness import keep_rows, parser_of, show_rows
from neuroanimator.learn.evaluation.drift import STEPS
from neuroanimator.terminal import progress_bar

TABLE = Path(__file__).with_name("drift.csv")

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
    parser = parser_of(__doc__, quick="1,000 super steps")
    parser.add_argument("names", nargs="*", metavar="EMULATOR")
    options = parser.parse_args()
    steps = QUICK_STEPS if options.quick else STEPS
    rows = [row for name in options.names or NAMES for row in rows_of(name, steps)]
    show_rows(rows)
    if not options.names:
        keep_rows(TABLE, rows, options)


if __name__ == "__main__":
    main()
