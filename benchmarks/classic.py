"""Open questions of the seminar of 1999, measured: the network of 1998, its training, its rivals; see docs/classic.md.

python benchmarks/classic.py units-pendulum      error over number of hidden units
python benchmarks/classic.py units-dolphin       the same
python benchmarks/classic.py super-steps         4 × 25, 2 × 50 and 1 × 100 physics steps over the same time
python benchmarks/classic.py spectra             spectra of emulated and true motion
python benchmarks/classic.py weights             the training error over two weights
python benchmarks/classic.py torques             J over two torques, and descents on it
python benchmarks/classic.py learning            on-line and batch learning beside today's
python benchmarks/classic.py race                a genetic algorithm among the other searches
python benchmarks/classic.py sensitivity         sensitivity of the network to torques, beside the mass matrix
python benchmarks/classic.py draw                every picture again, from the tables
python benchmarks/classic.py tables              the tables of the page, from the same

Several parts may be named; those that use the same networks then train them once. `--quick` is small and writes nothing. A
part takes at most five minutes on a core of its own, writes results/classic_PART.csv and draws docs/images/classic/PART.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from classic_cases.learning import learning_rows
from classic_cases.motion_spectra import chance_rows, spectrum_rows
from classic_cases.page import tables
from classic_cases.pictures import PICTURES
from classic_cases.race import race_rows
from classic_cases.sensitivity import map_rows, sensitivity_rows, summary_rows
from classic_cases.super_steps import super_step_rows
from classic_cases.surfaces import curvature_rows, descent_rows, torque_rows, weight_rows
from classic_cases.units import unit_rows

from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.speed import one_core
from neuroanimator.terminal import print_table

Rows = list[dict[str, Any]]

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
IMAGES = ROOT / "docs" / "images" / "classic"

MAX_PRINTED = 60
"""Longest table that is printed; longer ones are for pictures."""

Measure = Callable[[bool], dict[str, Rows]]
"""Whether it must be quick → the rows of each table."""


def _weights(is_quick: bool) -> dict[str, Rows]:
    return {"weights": weight_rows(is_quick), "curvatures": curvature_rows(is_quick)}


def _spectra(is_quick: bool) -> dict[str, Rows]:
    return {"spectra": spectrum_rows(is_quick), "spectra_chance": chance_rows(is_quick)}


def _torques(is_quick: bool) -> dict[str, Rows]:
    return {"torques": torque_rows(is_quick), "descents": descent_rows(is_quick)}


def _sensitivity(is_quick: bool) -> dict[str, Rows]:
    rows = sensitivity_rows(is_quick)
    return {"sensitivity_maps": map_rows(rows), "sensitivity": summary_rows(rows)}


PARTS: dict[str, Measure] = {
    "units-pendulum": lambda is_quick: {"units_pendulum": unit_rows("pendulum", is_quick)},
    "units-dolphin": lambda is_quick: {"units_dolphin": unit_rows("dolphin", is_quick)},
    "super-steps": lambda is_quick: {"super_steps": super_step_rows(is_quick)},
    "spectra": _spectra,
    "weights": _weights,
    "torques": _torques,
    "learning": lambda is_quick: {"learning": learning_rows(is_quick)},
    "race": lambda is_quick: {"race": race_rows(is_quick)},
    "sensitivity": _sensitivity,
}
"""What measures each part."""


def measure(part: str, is_quick: bool) -> None:
    """Measure one part, print its tables and write them."""
    with one_core():
        found = PARTS[part](is_quick)
    for name, rows in found.items():
        if len(rows) <= MAX_PRINTED:
            print_table(rows)
        if not is_quick:
            write_csv(RESULTS / f"classic_{name}.csv", rows)


def draw(names: list[str]) -> None:
    """Draw pictures from the tables."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    for name in names:
        PICTURES[name](IMAGES / f"{name}.png")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("parts", nargs="+", choices=[*PARTS, "draw", "tables"], metavar="PART")
    parser.add_argument("--quick", action="store_true", help="small; writes nothing")
    options = parser.parse_args()
    print(describe_machine())
    for part in options.parts:
        if part == "draw":
            draw(list(PICTURES))
        elif part == "tables":
            print("\n\n".join(tables()))
        else:
            measure(part, options.quick)


if __name__ == "__main__":
    main()
