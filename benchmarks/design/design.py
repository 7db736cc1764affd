"""The fish, and its gait, that swims far for little effort: `na.design` beside CMA-ES on the bodies' physics in C.

python -m benchmarks.design.design accuracy            errors of the family's emulator and of one fish's
python -m benchmarks.design.design identify --seeds 2  parameters of fish from recordings
python -m benchmarks.design.design searches            ten seeds: some minutes
python -m benchmarks.design.design searches --seeds 2 --seconds 20 --dry

Unknown are the length and the stiffness of a fish and 37 numbers of its gait. Both sides begin with the same fish at the same
gait and get the same J, which na.design verifies by the scheme of the truth; CMA-ES gets the physics as a user would run it, in
float32, sixteen bodies side by side on every core. It runs until its J is as good as that of na.design in the same run, by the
same physics, or for --seconds; compiling and importing are not counted for either.

A recording lasts four seconds: positions of all mass points of a fish with random parameters, which swims half by its gait and
half at random, with noise of half a millimetre.

Writes design.csv, a line per search: J, distance and effort by the scheme of the truth; design_accuracy.csv, a
line per emulator; and design_identify.csv, a line per recording and parameter.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # CMA-ES takes eigenvectors of 39 numbers: threads cost more than that

import numpy as np

import neuroanimator as na
from benchmarks.control.baselines.budgeted_cost import BudgetedCost, BudgetSpent
from benchmarks.control.baselines.derivative_free import cma_es
from benchmarks.design.fish import (
    VARIED,
    CostInC,
    Problem,
    first_guess,
    pose_fish,
    record_fish,
    swim_truly,
)
from benchmarks.harness import Clocks, Rows, keep_rows, parser_of, show_rows
from benchmarks.identification.accuracy import accuracy_rows
from benchmarks.identification.recordings import write_recording
from neuroanimator.control.descent.descend import start_of_body, vary_parameters
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.descent.problem import VariedParameters
from neuroanimator.control.synthesis.design import DESIGN_ITERATIONS

RESULTS = Path(__file__).parent
SEARCHES = RESULTS / "design.csv"
ACCURACY = RESULTS / "design_accuracy.csv"
IDENTIFIED = RESULTS / "design_identify.csv"

ONE_FISH = "fish-50"
"""Emulator of one body, of the same architecture as the family's."""

METHOD = "adam"
"""How na.design descends: as for the task of swimming."""


def our_row(emulator: na.Emulator, problem: Problem, seed: int) -> tuple[dict[str, Any], na.Design]:
    """Return the line of one `na.design`, and what it found."""
    options = DescentOptions(
        method=METHOD,
        parametrisation=problem.parametrisation,
        first=problem.first,
        seed=seed,
        iterations=DESIGN_ITERATIONS,
    )
    began = Clocks.now()
    found = na.design(
        emulator,
        problem.system,
        problem.objective,
        problem.start,
        parameters=VARIED,
        steps=problem.steps,
        options=options,
    )
    row = _row("na.design", seed, *began.passed())
    row |= _told(problem, found.start, found.synthesis.controls)
    return row, found


def nominal_row(problem: Problem, found: na.Design, seed: int) -> dict[str, Any]:
    """Return the line of the best motion of the nominal fish."""
    row = _row("na.design, nominal fish", seed, np.nan, np.nan)
    return row | _told(problem, problem.start, found.nominal.controls)


def cma_row(
    emulator: na.Emulator,
    problem: Problem,
    varied: VariedParameters,
    cost: CostInC,
    seed: int,
    target: float,
    seconds: float,
) -> dict[str, Any]:
    """Return the line of one CMA-ES until J is at most `target`, or for `seconds`."""
    guess = first_guess(problem, varied)
    began = Clocks.now()
    budget = BudgetedCost(cost, target, seconds)
    with suppress(BudgetSpent):
        cma_es(budget, guess, np.random.default_rng(seed))
    seconds_taken = budget.seconds
    cpu_seconds = began.passed().cpu_seconds
    assert budget.best is not None
    z = budget.best.astype(np.float32)
    values = np.asarray(varied.values(z), float)
    start = start_of_body(emulator, problem.start, varied.entries, values)
    controls = np.asarray(varied.controls(z), float)
    row = _row("CMA-ES on C", seed, seconds_taken, cpu_seconds)
    row |= _told(problem, start, controls)
    row["reached"] = budget.is_reached
    row["evaluations"] = budget.evaluations
    return row


def _row(method: str, seed: int, seconds: float, cpu_seconds: float) -> dict[str, Any]:
    row = {"method": method, "seed": seed, "seconds": seconds, "cpu_seconds": cpu_seconds}
    return row | {"reached": "", "evaluations": ""}


def _told(problem: Problem, start: np.ndarray, controls: np.ndarray) -> dict[str, Any]:
    swum = swim_truly(problem, start, controls)
    told: dict[str, Any] = {"J": swum.cost, "distance_m": swum.distance, "effort_s": swum.effort}
    for name in VARIED:
        told[name] = float(start[problem.system.state.index(name)][0])
    return told


def rows_of(emulator: na.Emulator, seeds: range, seconds: float) -> Rows:
    """Return the lines of all seeds: ours, CMA-ES in as much time, and until it is as good."""
    problem = pose_fish(emulator)
    varied = vary_parameters(emulator, VARIED, problem.parametrisation)
    cost = CostInC(emulator, problem, varied)
    cost.costs(np.tile(first_guess(problem, varied), (cost.batch, 1)))  # compiles
    our_row(emulator, problem, 0)
    rows: Rows = []
    for seed in seeds:
        ours, found = our_row(emulator, problem, seed)
        target = cost.cost_of(found.start, found.synthesis.controls)
        rows += [ours, nominal_row(problem, found, seed)]
        same = cma_row(emulator, problem, varied, cost, seed, -np.inf, ours["seconds"])
        rows.append(same | {"method": "CMA-ES on C, equal time"})
        until = cma_row(emulator, problem, varied, cost, seed, target, seconds)
        rows.append(until | {"method": "CMA-ES on C, until as good"})
        show_rows(rows[-4:])
    return rows


def identified_rows(emulator: na.Emulator, seed: int) -> Rows:
    """Return a line for each parameter of a random fish: its true value, and what `na.identify` finds of a recording."""
    system = na.load_system(emulator.system)
    recording = record_fish(system, emulator.dt, seed)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        write_recording(path, recording, system)
        began = Clocks.now()
        found = na.identify(emulator, path)
        seconds, cpu_seconds = began.passed()
    assert found.proven is not None
    rows: Rows = []
    for place, parameter in enumerate(system.parameters):
        width = parameter.high - parameter.low
        true = recording.true[place]
        row: dict[str, Any] = {"seed": seed, "parameter": parameter.name, "true": true}
        for name, fit in (("emulated", found.emulated), ("proven", found.proven)):
            row[name] = fit.values[place]
            row[f"{name}_off_range"] = abs(fit.values[place] - true) / width
        rows.append(row | {"seconds": seconds, "cpu_seconds": cpu_seconds})
    return rows


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("part", choices=["accuracy", "identify", "searches"])
    parser.add_argument("--emulator", default="fishes")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=60.0)
    arguments = parser.parse_args()
    emulator = na.load_emulator(arguments.emulator)
    if arguments.part == "accuracy":
        one_fish = na.load_emulator(ONE_FISH)
        rows = accuracy_rows({ONE_FISH: one_fish, emulator.system: emulator})
        show_rows(rows)
        keep_rows(ACCURACY, rows, arguments)
        return
    if arguments.part == "identify":
        rows = []
        for seed in range(arguments.seeds):
            rows += identified_rows(emulator, seed)
            show_rows(rows[-3:])
        keep_rows(IDENTIFIED, rows, arguments)
        return
    rows = rows_of(emulator, range(arguments.seeds), arguments.seconds)
    for key in ("seconds", "cpu_seconds"):
        ours = [row[key] for row in rows if row["method"] == "na.design"]
        theirs = [row[key] for row in rows if row["method"].endswith("as good")]
        low, middle, high = np.percentile(np.divide(theirs, ours), [25, 50, 75])
        print(f"{key} of CMA-ES over ours: median {middle:.1f}, quartiles {low:.1f} and {high:.1f}")
    keep_rows(SEARCHES, rows, arguments)


if __name__ == "__main__":
    main()
