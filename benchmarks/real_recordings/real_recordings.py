"""Compared with the real world: recorded pendulums, a robot and tossed cubes; real_recordings.csv.

python -m benchmarks.real_recordings.real_recordings --data FOLDER  with a folder of checkouts of the authors' files
python -m benchmarks.real_recordings.real_recordings --data FOLDER --fetch         fetches missing ones first
python -m benchmarks.real_recordings.real_recordings --data FOLDER --quick         one case, no fit; writes no file
python -m benchmarks.real_recordings.real_recordings --data FOLDER --rows b        some of the rows; the others' lines stay
python -m benchmarks.real_recordings.real_recordings --data FOLDER --write OUT     only writes them as recordings of this project
python -m benchmarks.real_recordings.real_recordings --data FOLDER --excerpts OUT  only writes some seconds of each, with licences

Rows: (a) physics with the authors' own parameters; (b) physics with ours, fitted by finite differences, and through the
emulator of a family; (c) that emulator at these parameters; (d) the same after it has learnt from the training part; (e) a
network of the training part alone; (f) persistence, constant velocity and a linear model;
(n) the error of (a) due to noise in the measured starts alone, a lower bound of every error. Every method begins at the
same measured states of unseen motion. Errors are defined in errors.py, unseen runs in the modules that
read them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.harness import Clocks, keep_rows, parser_of, show_rows
from benchmarks.real_recordings.bounds import SHARES
from benchmarks.real_recordings.cases import CASES, Case, windows
from benchmarks.real_recordings.cube_emulators import cube_emulator, cube_fine_tuned
from benchmarks.real_recordings.errors import error_rows
from benchmarks.real_recordings.excerpts import write_excerpts
from benchmarks.real_recordings.families import (
    fine_tuned_emulator,
    identified_emulator,
    identified_physics,
    of_chains,
    recording_alone,
)
from benchmarks.real_recordings.fitted_physics import fitted_physics
from benchmarks.real_recordings.lyapunov import lyapunov_time
from benchmarks.real_recordings.methods import FREE_METHODS, Method, making_cells, start_noise
from benchmarks.real_recordings.runs import write_recording
from benchmarks.real_recordings.source_files import fetch

TABLE = Path(__file__).with_name("real_recordings.csv")

METHODS: dict[str, tuple[str, Method]] = FREE_METHODS | {
    "physics, fitted by us": ("b", fitted_physics),
    "physics, identified": ("b", of_chains(identified_physics)),
    "emulator, identified": ("c", of_chains(identified_emulator)),
    "emulator, fine-tuned": ("d", of_chains(fine_tuned_emulator)),
    "emulator, of the fitted physics": ("c", cube_emulator),
    "emulator of the fitted physics, fine-tuned": ("d", cube_fine_tuned),
    "recording alone": ("e", recording_alone),
}
"""By its name, each method's row of the table and the function that makes it."""

NOISE_ROW = "n"

ALL_ROWS = "".join(sorted({row for row, _ in METHODS.values()} | {NOISE_ROW}))

QUICK_ROWS = "afn"
"""Rows of a quick run: nothing is fitted."""

FIGURES = (
    "making_s",
    "making_cpu_s",
    "predicting_s",
    "iterations",
    "rollouts",
    "cost_before",
    "cost_after",
    "at_bounds",
    *SHARES,
    "fitted",
)
"""Cells that say what a method took, and how often bounds of its error hold; empty where they have no meaning."""


def rows_of(case: Case, data: Path, rows_told: str) -> list[dict[str, Any]]:
    """Return a case's lines of the table, of those rows alone, such as "af"."""
    training, unseen_runs = case.read(data)
    unseen = windows(case, unseen_runs)
    lyapunov: float | str = ""
    if not case.is_cube:
        lyapunov = lyapunov_time(case, unseen)
    rows = []

    def tell(row: str, method: str, states: Any, figures: dict[str, Any]) -> None:
        for line in error_rows(case, unseen, states):
            cells = {name: figures.get(name, "") for name in FIGURES}
            head = {"case": case.name, "row": row, "method": method}
            rows.append(head | line | {"lyapunov_s": lyapunov} | cells)

    for name, (row, method) in METHODS.items():
        if row not in rows_told:
            continue
        began = Clocks.now()
        prediction = method(case, training)
        if prediction is None:
            continue
        making = making_cells(began.passed())
        made = Clocks.now()
        states = prediction.predict(unseen.starts, unseen.controls)
        seconds = making | {"predicting_s": made.passed().seconds}
        shares = {} if prediction.shares is None else prediction.shares(unseen)
        tell(row, name, states, seconds | shares | prediction.figures)
    if unseen.halves is not None and NOISE_ROW in rows_told:
        tell(NOISE_ROW, "noise of the starts", start_noise(case, unseen), {})
    return rows


def write_recordings(folder: Path, data: Path) -> None:
    """Write the training and the unseen part of every case as recordings of this project."""
    folder.mkdir(parents=True, exist_ok=True)
    for case in CASES:
        stem = case.name.replace(",", "").replace(" ", "_")
        training, unseen = case.read(data)
        write_recording(folder / f"{stem}_training.csv", training, case.columns, case.dt)
        write_recording(folder / f"{stem}_unseen.csv", unseen, case.columns, case.dt)


def main() -> None:
    parser = parser_of(__doc__, quick="one case, no fit")
    parser.add_argument("--data", type=Path, required=True, help="folder of checkouts")
    parser.add_argument("--fetch", action="store_true", help="get files that are missing there")
    parser.add_argument("--rows", default=ALL_ROWS, help="letters of the rows to measure")
    parser.add_argument("--cases", default="", help="measure cases whose name has this in it")
    parser.add_argument("--write", type=Path, help="write the recordings into this folder")
    parser.add_argument("--excerpts", type=Path, help="write excerpts into this folder")
    arguments = parser.parse_args()
    if arguments.fetch:
        fetch(arguments.data)
    if arguments.write is not None:
        write_recordings(arguments.write, arguments.data)
    if arguments.excerpts is not None:
        write_excerpts(arguments.excerpts, arguments.data)
    if arguments.write is not None or arguments.excerpts is not None:
        return
    cases = CASES[:1] if arguments.quick else CASES
    cases = [case for case in cases if arguments.cases in case.name]
    rows_told = QUICK_ROWS if arguments.quick else arguments.rows
    names = [case.name for case in CASES]

    def place(row: dict[str, Any]) -> tuple[int, str]:
        return names.index(row["case"]), row["row"]

    for case in cases:
        lines = rows_of(case, arguments.data, rows_told)
        show_rows(lines)
        keep_rows(TABLE, lines, arguments, "case", "row", "method", "measure", order=place)


if __name__ == "__main__":
    main()
