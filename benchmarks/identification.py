"""An emulator of a family of arms, and ten parameters of one of them from recordings, beside MuJoCo's own toolbox.

python benchmarks/identification.py accuracy                      errors of a family's emulators and of one body's
python benchmarks/identification.py recordings                    five recordings; wants pip install 'mujoco[sysid]'
python benchmarks/identification.py recordings --seeds 1 --dry

Emulators are taken from the folder --emulators, and made there if they are missing: 15 minutes of two cores. A recording
lasts five seconds, of a body with ten parameters within 30 % of nominal ones, with noise of one per cent in angles and
velocities. Whoever identifies gets the same files and bounds, and begins at nominal values. Both sides run in turn in one
process on the cores it may use.

Writes results/identification_accuracy.csv, results/identification.csv (a line a run, failures too) and
results/identification_summary.csv (medians).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from identification_cases.emulators import CASES, FILES, LARGE_FAMILY, made
from identification_cases.recordings import Recording, record, write_recording
from identification_cases.toolbox import (
    OPTIMISERS,
    WAYS,
    Outcome,
    Problem,
    Way,
    require_toolbox,
    run_toolbox,
)
from jaxtyping import Float

import neuroanimator as na
from neuroanimator import Emulator
from neuroanimator.evaluation.accuracy import one_step_error, root_mean_square
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.held_out import held_out_runs, system_of
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.systems.system import Scheme, System
from neuroanimator.terminal import print_table

Rows = list[dict[str, Any]]

RESULTS = Path(__file__).parent / "results"

SECONDS = 5.0
"""Length of a recording [s]."""

TOLERANCE = 0.05
"""A parameter within this share of its range of the true one is found."""

LIMIT = 120.0
"""Time a run of the toolbox gets [s]."""

TEST_RUNS = 100
"""Number of unseen runs of the accuracy table."""

MODEL_STEP = Scheme("implicitfast", 0.002)
TRUE_STEP = Scheme("rk4", 0.002)
COARSE_STEP = Scheme("rk4", 0.01)
SCHEMES = (MODEL_STEP, TRUE_STEP, COARSE_STEP)
"""How the toolbox's physics is stepped: as the model says, as the recordings were made, and as coarsely as RK4 allows."""


def accuracy_rows(folder: Path) -> Rows:
    """Return a line for each emulator: its error on unseen runs over that of one body's emulator."""
    rows: Rows = []
    for case in CASES:
        emulator, data_seconds, training_seconds = made(case, folder)
        test = held_out_runs(emulator, TEST_RUNS)
        row: dict[str, Any] = {"emulator": case.name, "of": case.of}
        row["transitions"] = case.transitions
        row["widths"] = " ".join(map(str, case.training.get("widths", ("usual",))))
        row["updates"] = case.training.get("updates", "usual")
        row["one_step_error"] = float(root_mean_square(one_step_error(emulator, test)))
        row["over_one_body"] = row["one_step_error"] / (rows or [row])[0]["one_step_error"]
        row["data_s"] = data_seconds
        row["training_s"] = training_seconds
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
    began = time.perf_counter()
    cpu_began = time.process_time()
    found = na.identify(emulator, path)
    seconds = time.perf_counter() - began
    cpu_seconds = time.process_time() - cpu_began
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
    """Return the medians of each method over its runs, and how long ours takes of them.

    An emulator pays for itself after so many identifications as it took times what one saves.
    """
    groups: dict[tuple[str, str, str], Rows] = {}
    for row in rows:
        key = (row["method"], row["optimiser"], row["physics"])
        groups.setdefault(key, []).append(row)
    ours = median(groups[("ours", "", "rk4 2 ms")], "seconds")
    ours_an_iteration = median(groups[("ours, emulator alone", "", "")], "ms_an_iteration")
    found = []
    for (method, optimiser, physics), group in groups.items():
        seconds = median(group, "seconds")
        saved = seconds - ours
        found.append(
            {
                "method": method,
                "optimiser": optimiser,
                "physics": physics,
                "runs": len(group),
                "found": sum(row["is_found"] for row in group),
                "worst_error": median(group, "worst_error"),
                "mean_error": median(group, "mean_error"),
                "seconds": seconds,
                "cpu_seconds": median(group, "cpu_seconds"),
                "seconds_to_tolerance": median(group, "seconds_to_tolerance"),
                "iterations": median(group, "iterations"),
                "ms_an_iteration": median(group, "ms_an_iteration"),
                "seconds_over_ours": seconds / ours,
                "iteration_over_ours": median(group, "ms_an_iteration") / ours_an_iteration,
                "break_even_identifications": making_seconds / saved if saved > 0 else np.inf,
            }
        )
    return found


def median(rows: Rows, key: str) -> float:
    """Return the median of a column."""
    return float(np.median([row[key] for row in rows]))


def recording_rows(emulator: Emulator, seeds: Iterable[int], repeats: int) -> Iterable[Rows]:
    """Yield the lines of each recording: every way to give the toolbox, with each of its optimisers and steps for the first
    recording and with the best of them for all; ours in turn with them."""
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
        for seed in others:
            recording = record(system, emulator.dt, SECONDS, seed)
            write_recording(path, recording, system)
            for way, optimiser, scheme in chosen:
                for _ in range(repeats):
                    rows = our_rows(emulator, path, recording, system, seed)
                    rows.append(toolbox_row(way, optimiser, scheme, recording, system, seed))
                    yield rows


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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("part", choices=["accuracy", "recordings"])
    parser.add_argument("--emulators", type=Path, default=Path("emulators"))
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    print(describe_machine())
    if arguments.part == "accuracy":
        rows = accuracy_rows(arguments.emulators)
        print_table(rows)
        if not arguments.dry:
            write_csv(RESULTS / "identification_accuracy.csv", rows)
        return
    require_toolbox()
    na.trust_files(FILES / LARGE_FAMILY.toml)
    emulator, data_seconds, training_seconds = made(LARGE_FAMILY, arguments.emulators)
    rows = []
    for some in recording_rows(emulator, range(arguments.seeds), arguments.repeats):
        print_table(some)
        rows += some
        if not arguments.dry:
            write_csv(RESULTS / "identification.csv", rows)
    summary = summary_rows(rows, data_seconds + training_seconds)
    print_table(summary)
    if not arguments.dry:
        write_csv(RESULTS / "identification_summary.csv", summary)


if __name__ == "__main__":
    main()
