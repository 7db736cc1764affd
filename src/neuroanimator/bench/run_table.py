"""Table 1 of the paper for every system the project has: rows, CSV, plot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroanimator.bench.csv_table import write_csv
from neuroanimator.bench.paper_table import measure_row
from neuroanimator.bench.training_time import time_chunk
from neuroanimator.data.generate import generate
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.evaluation.evaluate import QUICK, THOROUGH
from neuroanimator.evaluation.work_precision import draw_work_precision
from neuroanimator.executor.executor import Executor
from neuroanimator.terminal import progress_bar
from neuroanimator.training.recipes import RECIPES, cook
from neuroanimator.zoo import SHIPPED, emulator_name

Choice = list[tuple[str, int]]
"""Pairs of a system and its n, the physics steps of a super step."""


TRAINING_SECONDS = 48 * 3600.0
"""A worker that takes longer for a training counts as hung [s]."""


@dataclass(frozen=True)
class SeedTask:
    """One training of a further seed, in a folder that its worker sees."""

    system: str
    substeps: int
    seed: int
    folder: str

    @property
    def label(self) -> str:
        """What errors call it."""
        return f"{emulator_name(self.system, self.substeps)}, seed {self.seed}"


def run_seed_task(task: SeedTask) -> None:
    """Train one further seed, unless it is there."""
    cook(task.system, task.substeps, Path(task.folder), seed=task.seed, has_data=True)


def train_seeds(chosen: Choice, seeds: int, out: Path, executor: Executor) -> None:
    """Train all further seeds of the `chosen` rows in `out`."""
    if seeds > 1 and not executor.shares_disk:
        raise ArgumentError(
            "bench: its trainings stay in a folder of this machine: use --executor local or ray."
        )
    for system, n in chosen:
        recipe = RECIPES[system]
        stride = recipe.stride(n)
        if seeds > 1:  # the data of all seeds, which no two of them should make at once
            data = out / emulator_name(system, stride)
            generate(recipe.data(system, stride), data, executor=executor)
    tasks = []
    for system, n in chosen:
        for seed in range(1, seeds):
            tasks.append(SeedTask(system, n, seed, str(out.resolve())))
    executor.map(run_seed_task, tasks, longest=TRAINING_SECONDS)


def chosen_rows(systems: str | None, substeps: str | None) -> Choice:
    """Return the (system, n) pairs that comma-separated names and numbers leave; all of them without."""
    known_systems = {system for system, _ in SHIPPED}
    known_substeps = {str(n) for _, n in SHIPPED}
    names = set(systems.split(",")) if systems else known_systems
    counts = set(substeps.split(",")) if substeps else known_substeps
    chosen = [(system, n) for system, n in sorted(SHIPPED) if system in names and str(n) in counts]
    unknown = (names - known_systems) | (counts - known_substeps)
    if unknown or not chosen:
        valid = ", ".join(emulator_name(*row) for row in sorted(SHIPPED))
        raise ArgumentError(f"bench: no rows for {', '.join(sorted(unknown))}. Rows: {valid}.")
    return chosen


def run_table(
    chosen: Choice, out: Path, *, is_quick: bool, seeds: int, executor: Executor | None = None
) -> tuple[list[dict[str, Any]], list[Path]]:
    """Return (one dictionary per row, files written); further training seeds are trained in `out` and kept.

    The `executor` trains them, all before anything is measured: times are taken when nothing else is computed.
    """
    if executor is not None:
        train_seeds(chosen, seeds, out, executor)
    budget = QUICK if is_quick else THOROUGH
    rows = []
    chunk_seconds: dict[str, float] = {}
    with progress_bar("rows", len(chosen)) as bar:
        for system, n in chosen:
            bar.advance_to(len(rows), emulator_name(system, n))
            emulators = [Emulator.load(emulator_name(system, n))]
            for seed in range(1, seeds):
                emulator, _ = cook(system, n, out, seed=seed)
                emulators.append(emulator)
            if system not in chunk_seconds:
                recipe = RECIPES[system]
                config = recipe.training(recipe.stride(n))
                chunk_seconds[system] = time_chunk(emulators[0], config)
            rows.append(measure_row(emulators, chunk_seconds[system], budget))
    figures = [row.figures for row in rows]
    evaluations = [evaluation for row in rows for evaluation in row.evaluations]
    table = out / "table1.csv"
    plot = out / "work-precision.png"
    write_csv(table, figures)
    draw_work_precision(evaluations, plot)
    return figures, [table, plot]
