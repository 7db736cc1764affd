"""Emulators of families, and ten parameters of an arm of one of them from recordings, beside MuJoCo's own toolbox.

python -m benchmarks.identification.identification accuracy    errors of families' emulators, and of one body of each
python -m benchmarks.identification.identification recordings  six recordings; needs pip install 'mujoco[sysid]'
python -m benchmarks.identification.identification recordings --seeds 1 --dry
python -m benchmarks.identification.identification summary     medians and ratios of these two tables

Emulators are taken from the folder --emulators, and made there if they are missing: 15 minutes of two cores. A recording
lasts five seconds, of a body with ten parameters within 30 % of nominal ones, with noise of one per cent in angles and
velocities. All methods get the same files and bounds, and begin at nominal values. Both sides run in turn in one
process on the cores it may use.

Writes identification_accuracy.csv, identification.csv (a line per run, including failures) and
identification_summary.csv (medians).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float

import neuroanimator as na
from benchmarks.harness import Clocks, Rows, keep_rows, parser_of, read_rows, show_rows
from benchmarks.identification.accuracy import accuracy_rows
from benchmarks.identification.emulators import LARGE_FAMILY, SYSTEMS, made
from benchmarks.identification.recordings import Recording, record, write_recording
from benchmarks.identification.toolbox import (
    OPTIMISERS,
    WAYS,
    Outcome,
    Problem,
    Way,
    require_toolbox,
    run_toolbox,
)
from neuroanimator import Emulator
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.systems.system import Scheme, System

RESULTS = Path(__file__).parent
ACCURACY = RESULTS / "identification_accuracy.csv"
RUNS = RESULTS / "identification.csv"
SUMMARY = RESULTS / "identification_summary.csv"

SECONDS = 5.0
"""Length of a recording [s]."""

TOLERANCE = 0.05
"""A parameter within this share of its range of the true one is found."""

LIMIT = 120.0
"""Time a run of the toolbox gets [s]."""

MODEL_STEP = Scheme("implicitfast", 0.002)
TRUE_STEP = Scheme("rk4", 0.002)
COARSE_STEP = Scheme("rk4", 0.01)
SCHEMES = (MODEL_STEP, TRUE_STEP, COARSE_STEP)
"""How the toolbox's physics is stepped: as the model says, as the recordings were made, and as coarsely as RK4 allows."""


def table_rows(folder: Path, only: str) -> Rows:
    """Return a line for each emulator, of systems whose name has `only` in it: its error over that of its one body's emulator."""
    rows: Rows = []
    for system, cases in SYSTEMS.items():
        if only not in system:
            continue
        each = {case.name: made(case, folder) for case in cases}
        lines = accuracy_rows({name: one.emulator for name, one in each.items()})
        for case, line in zip(cases, lines, strict=True):
            one = each[case.name]
            row = {"system": system, "of": case.of} | line
            row["transitions"] = case.transitions
            row["updates"] = one.updates
            row["data_s"] = one.data_seconds
            row["training_s"] = one.training_seconds
            rows.append(row)
    return rows


def errors_of(
    values: Float[np.ndarray, " P"], recording: Recording, system: System
) -> Float[np.ndarray, " P"]:
    """Return how far parameters are off the true ones, as shares of their ranges."""
    ranges = [parameter.high - parameter.low for parameter in system.parameters]
    return np.abs(values - recording.true) / np.array(ranges)


def our_rows(
    emulator: Emulator, path: Path, recording: Recording, system: System, seed: int
) -> Rows:
    """Return the lines of one `na.identify`: of its first stage, by the emulator, and of the whole."""
    began = Clocks.now()
    found = na.identify(emulator, path)
    seconds, cpu_seconds = began.passed()
    assert found.proven is not None
    count = len(system.parameters)
    emulated = found.emulated.values[:count]
    physics_iterations = found.proven.iterations
    first = _row("ours, emulator alone", "", "", seed)
    first |= _times(found.seconds_of_emulator, np.nan, found.emulated.iterations)
    first |= _errors(errors_of(emulated, recording, system))
    first["seconds_to_tolerance"] = first["seconds"] if first["is_found"] else np.inf
    whole = _row("ours", "", "rk4 2 ms", seed)
    whole |= _times(seconds, cpu_seconds, found.emulated.iterations + physics_iterations)
    whole |= _errors(errors_of(found.proven.values[:count], recording, system))
    whole["seconds_to_tolerance"] = whole["seconds"] if whole["is_found"] else np.inf
    if first["is_found"] and whole["is_found"]:
        whole["seconds_to_tolerance"] = first["seconds"]
    return [first | {"end": "converged"}, whole | {"end": "converged"}]


def toolbox_row(
    way: Way,
    optimiser: str,
    scheme: Scheme,
    recording: Recording,
    system: Any,
    seed: int,
) -> dict[str, Any]:
    """Return the line of one run of the toolbox."""
    problem = Problem(recording, system, scheme, way)
    outcome = run_toolbox(problem, optimiser, LIMIT)
    row = _row(f"toolbox, {way.name}", optimiser, _name_of(scheme), seed)
    row |= _times(outcome.seconds, outcome.cpu_seconds, outcome.iterations)
    row |= _errors(errors_of(outcome.values, recording, system))
    row["seconds_to_tolerance"] = np.inf
    if row["is_found"]:
        row["seconds_to_tolerance"] = _first_within(outcome, recording, system)
    return row | {"end": outcome.end}


def _first_within(outcome: Outcome, recording: Recording, system: System) -> float:
    """Return when the toolbox first tried a point with all parameters within the tolerance [s]."""
    for seconds, values in outcome.trials:
        if errors_of(values, recording, system).max() <= TOLERANCE:
            return seconds
    return outcome.seconds


def _name_of(scheme: Scheme) -> str:
    return f"{scheme.integrator} {scheme.dt * 1e3:g} ms"


def _row(method: str, optimiser: str, physics: str, seed: int) -> dict[str, Any]:
    return {"method": method, "optimiser": optimiser, "physics": physics, "seed": seed}


def _times(seconds: float, cpu_seconds: float, iterations: int) -> dict[str, Any]:
    each = 1e3 * seconds / iterations if iterations else np.nan
    return {
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
        "iterations": iterations,
        "ms_an_iteration": each,
    }


def _errors(errors: Float[np.ndarray, " P"]) -> dict[str, Any]:
    return {
        "worst_error": float(errors.max()),
        "mean_error": float(errors.mean()),
        "is_found": bool(errors.max() <= TOLERANCE),
    }


def summary_rows(rows: Rows, making_seconds: float) -> Rows:
    """Return the medians of each method over its recordings, and the ratios of its times to ours of the same recordings.

    An emulator pays for itself after as many identifications as its making takes of what one saves.
    """
    ours = [row for row in rows if row["method"] == "ours"]
    alone = [row for row in rows if row["method"] == "ours, emulator alone"]
    groups: dict[tuple[str, str, str], Rows] = {}
    for row in rows:
        key = (row["method"], row["optimiser"], row["physics"])
        groups.setdefault(key, []).append(row)
    summary = []
    for (method, optimiser, physics), group in groups.items():
        errors = of_recordings(group, "worst_error")
        seconds = of_recordings(group, "seconds")
        our_seconds = of_recordings(ours, "seconds")
        saved = median(seconds[seed] - our_seconds[seed] for seed in seconds)
        line: dict[str, Any] = {"method": method, "optimiser": optimiser, "physics": physics}
        line["recordings"] = len(errors)
        line["found"] = sum(error <= TOLERANCE for error in errors.values())
        for key in MEDIANS:
            line[key] = median(of_recordings(group, key).values())
        for key in RATIOS:
            line[f"{key}_over_ours"] = ratio(group, ours, key)
        line["iteration_over_emulators"] = ratio(group, alone, "ms_an_iteration")
        line["break_even_identifications"] = making_seconds / saved if saved > 0 else np.inf
        summary.append(line)
    return summary


MEDIANS = ("worst_error", "mean_error", "seconds", "cpu_seconds", "iterations", "ms_an_iteration")
"""Columns whose medians are in the summary."""

RATIOS = ("seconds", "cpu_seconds", "seconds_to_tolerance")
"""Columns that are compared with ours."""


def of_recordings(rows: Rows, key: str) -> dict[int, float]:
    """Return the median of a column for each recording."""
    seeds = dict.fromkeys(row["seed"] for row in rows)
    return {seed: median(row[key] for row in rows if row["seed"] == seed) for seed in seeds}


def ratio(rows: Rows, ours: Rows, key: str) -> float:
    """Return the median over recordings of a time over ours; those that neither could find do not count."""
    theirs = of_recordings(rows, key)
    our_own = of_recordings(ours, key)
    found = [seed for seed in theirs if min(theirs[seed], our_own[seed]) < np.inf]
    return median(theirs[seed] / our_own[seed] for seed in found)


def median(values: Iterable[float]) -> float:
    """Return the median; not a number of no values."""
    numbers = sorted(values)
    return float(np.median(numbers)) if numbers else np.nan


def read_numbers(path: Path) -> Rows:
    """Return the rows of one of the tables."""
    return [{key: _number(value) for key, value in row.items()} for row in read_rows(path)]


def _number(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


def recording_rows(emulator: Emulator, seeds: Iterable[int], repeats: int) -> Iterable[Rows]:
    """Yield the lines of each recording: every way to give the toolbox, with each of its optimisers and steps for the first
    recording, with the best of them and a second optimiser for all; ours in turn with them."""
    system: Any = system_of(emulator)
    first, *others = seeds
    with TemporaryDirectory() as name:
        path = Path(name) / "recording.csv"
        recording = record(system, emulator.dt, SECONDS, first)
        write_recording(path, recording, system)
        cold = our_rows(emulator, path, recording, system, first)
        yield [row | {"method": f"{row['method']}, first in a process"} for row in cold]
        chosen = []
        for way in WAYS:
            trials: Rows = []
            for optimiser, scheme in settings_of(way):
                trials += our_rows(emulator, path, recording, system, first)
                trials.append(toolbox_row(way, optimiser, scheme, recording, system, first))
            yield trials
            chosen.append((way, *best_of(trials)))
        chosen += SECOND_OPINIONS
        for seed in others:
            recording = record(system, emulator.dt, SECONDS, seed)
            write_recording(path, recording, system)
            for way, optimiser, scheme in chosen:
                for _ in range(repeats):
                    rows = our_rows(emulator, path, recording, system, seed)
                    rows.append(toolbox_row(way, optimiser, scheme, recording, system, seed))
                    yield rows


SECOND_OPINIONS = [(way, "scipy parallel", COARSE_STEP) for way in WAYS[:3]]
"""What is tried on every recording beside the best of the first one; the last way takes too long."""


def settings_of(way: Way) -> list[tuple[str, Scheme]]:
    """Return the optimisers and steps that are tried: all optimisers by the model's own step, the default one by others."""
    tried = [(optimiser, MODEL_STEP) for optimiser in OPTIMISERS]
    if way.window is not None and way.has_unknown_starts:
        tried = [("mujoco", MODEL_STEP), ("mujoco scaled", MODEL_STEP)]  # minutes each
    return [*tried, ("mujoco", TRUE_STEP), ("mujoco", COARSE_STEP)]


def best_of(rows: Rows) -> tuple[str, Scheme]:
    """Return the optimiser and the step of the toolbox that found the parameters soonest, or else came nearest."""
    toolbox = [row for row in rows if row["optimiser"]]
    best = min(toolbox, key=lambda row: (row["seconds_to_tolerance"], row["worst_error"]))
    scheme = next(scheme for scheme in SCHEMES if _name_of(scheme) == best["physics"])
    return best["optimiser"], scheme


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("part", choices=["accuracy", "recordings", "summary"])
    parser.add_argument("--emulators", type=Path, default=Path("emulators"))
    parser.add_argument(
        "--systems",
        default="",
        help="accuracy of systems whose name has this in it; others' lines stay",
    )
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--repeats", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.part == "accuracy":
        rows = table_rows(arguments.emulators, arguments.systems)
        show_rows(rows)
        order = list(SYSTEMS).index
        keep_rows(ACCURACY, rows, arguments, "system", order=lambda row: order(row["system"]))
    elif arguments.part == "recordings":
        require_toolbox()
        emulator = made(LARGE_FAMILY, arguments.emulators).emulator
        rows = []
        for some in recording_rows(emulator, range(arguments.seeds), arguments.repeats):
            show_rows(some)
            rows += some
            keep_rows(RUNS, rows, arguments)
    else:
        making = next(r for r in read_numbers(ACCURACY) if r["emulator"] == LARGE_FAMILY.name)
        summary = summary_rows(read_numbers(RUNS), making["data_s"] + making["training_s"])
        show_rows(summary)
        keep_rows(SUMMARY, summary, arguments)


if __name__ == "__main__":
    main()
