"""Error and cost of the emulators that ship in more than one size.

python -m benchmarks.equal_error.sizes          table, and sizes.csv
python -m benchmarks.equal_error.sizes --quick  fewer runs and repeats; writes no file
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Rows, keep_rows, parser_of, show_rows
from neuroanimator import Emulator, load_emulator
from neuroanimator.files.zoo import LARGE, emulator_name
from neuroanimator.learn.evaluation.accuracy import one_step_error, rollout_error, root_mean_square
from neuroanimator.learn.evaluation.held_out import HELD_OUT_RUNS, held_out_runs
from neuroanimator.learn.evaluation.speed import (
    IN_C,
    IN_JAX,
    REPEATS,
    emulator_players,
    interleaved,
    one_core,
)
from neuroanimator.learn.evaluation.stability import count_diverged

SIZES = ("", "large")
SETS = 3
"""Sets of held-out runs: errors that come from few events differ between them by a third."""

STARTS = 200
"""Random starts of long rollouts."""

STEPS = 1000
"""Super steps of each."""


def rows_of(system: str, substeps: int, *, is_quick: bool) -> Rows:
    """Return a row for every size; costs are over that of the usual size in JAX, measured in turn."""
    emulators = {size: load_emulator(emulator_name(system, substeps, size)) for size in SIZES}
    costs = _costs(emulators, repeats=3 if is_quick else REPEATS)
    rows = []
    for size, emulator in emulators.items():
        row: dict[str, Any] = {"emulator": emulator_name(system, substeps, size)}
        row["strides"] = emulator.strides
        row["widths"] = "-".join(map(str, emulator.network.widths))
        row |= _errors(emulator, sets=1 if is_quick else SETS)
        row["cost_in_c"] = costs[size, IN_C]
        row["cost_in_jax"] = costs[size, IN_JAX]
        row["diverged"] = count_diverged(emulator, 20 if is_quick else STARTS, STEPS)
        rows.append(row)
    return rows


def _errors(emulator: Emulator, sets: int) -> dict[str, float]:
    """Return the mean, the least and the largest error of one super step, and the error after a second."""
    one_step = []
    after_second = []
    for seed in range(sets):
        test = held_out_runs(emulator, count=HELD_OUT_RUNS, seed=seed)
        one_step.append(float(root_mean_square(one_step_error(emulator, test))))
        emulated = emulator.rollout(test.states[:, 0], test.controls, may_diverge=True)
        over_time = rollout_error(test.frame, np.asarray(emulated, float), test.states)
        after_second.append(float(over_time[round(1 / emulator.dt)]))
    return {
        "one_step_error": float(np.mean(one_step)),
        "least": min(one_step),
        "largest": max(one_step),
        "error_after_1s": float(np.mean(after_second)),
    }


def _costs(emulators: dict[str, Emulator], repeats: int) -> dict[tuple[str, str], float]:
    """Return the time of a super step by (size, runtime), over that of the usual size in JAX. Needs a C compiler."""
    players = {}
    for size, emulator in emulators.items():
        for runtime, play in emulator_players(emulator).items():
            players[f"{size}: {runtime}"] = play
    with one_core():
        seconds = interleaved(players, repeats)
    unit = seconds[f"{SIZES[0]}: {IN_JAX}"]
    costs = {}
    for size in emulators:
        for runtime in (IN_C, IN_JAX):
            costs[size, runtime] = seconds[f"{size}: {runtime}"] / unit
    return costs


def main() -> None:
    parser = parser_of(__doc__, quick="fewer runs")
    options = parser.parse_args()
    rows = []
    for system, substeps in LARGE:
        rows += rows_of(system, substeps, is_quick=options.quick)
    show_rows(rows)
    keep_rows(Path(__file__).with_name("sizes.csv"), rows, options)


if __name__ == "__main__":
    main()
