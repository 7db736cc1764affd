"""Table 1 of the paper for every system the project has: rows, CSV, plot."""

from __future__ import annotations

import csv
import io
import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from neuroanimator.bench.paper_table import measure_row
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.evaluation.evaluate import QUICK, THOROUGH
from neuroanimator.evaluation.work_precision import draw_work_precision
from neuroanimator.storage.files import write_whole
from neuroanimator.terminal import progress_bar
from neuroanimator.training.recipes import RECIPES, cook
from neuroanimator.training.train import time_chunk
from neuroanimator.zoo import SHIPPED, find_emulator

Wanted = list[tuple[str, int]]


def chosen_rows(systems: str | None, substeps: str | None) -> Wanted:
    """Return the (system, n) pairs that comma-separated wishes leave; all of them without wishes."""
    names = systems.split(",") if systems else [system for system, _ in SHIPPED]
    counts = substeps.split(",") if substeps else [str(n) for _, n in SHIPPED]
    chosen = [(system, n) for system, n in sorted(SHIPPED) if system in names and str(n) in counts]
    unknown = {*names} - {system for system, _ in SHIPPED} | (
        {*counts} - {str(n) for _, n in SHIPPED}
    )
    if unknown or not chosen:
        valid = ", ".join(f"{system}-{n}" for system, n in sorted(SHIPPED))
        raise ArgumentError(f"bench: no rows for {', '.join(sorted(unknown))}. Rows: {valid}.")
    return chosen


def run_table(
    wanted: Wanted, out: Path, *, is_quick: bool, seeds: int
) -> tuple[list[dict[str, Any]], list[Path]]:
    """Return (one dictionary per row, files written); further training seeds are cooked in `out` and kept."""
    rows, chunk_seconds = [], {}
    with progress_bar("rows", len(wanted)) as bar:
        for system, n in wanted:
            bar.advance_to(len(rows), f"{system}-{n}")
            emulators = [Emulator.load(find_emulator(f"{system}-{n}"))]
            emulators += [cook(system, n, out, seed=seed)[0] for seed in range(1, seeds)]
            if system not in chunk_seconds:
                chunk_seconds[system] = time_chunk(emulators[0], RECIPES[system].training(n))
            rows.append(
                measure_row(emulators, chunk_seconds[system], QUICK if is_quick else THOROUGH)
            )
    figures = [row.figures for row in rows]
    table, plot = out / "table1.csv", out / "work-precision.png"
    write_csv(table, figures)
    draw_work_precision([each for row in rows for each in row.evaluations], plot)
    return figures, [table, plot]


def describe_machine() -> str:
    """Return processor, cores and versions in one line."""
    cpu = platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
        cpu = next(
            (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), cpu
        )
    packages = ", ".join(f"{name} {version(name)}" for name in ("jax", "mujoco", "numpy"))
    return f"{cpu}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}, {packages}, float32"


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows of the same keys, the machine's description in the first line."""
    text = io.StringIO()
    text.write(f"# {describe_machine()}\n")
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {key: f"{v:.5g}" if isinstance(v, float) else v for key, v in row.items()} for row in rows
    )
    write_whole(path, text.getvalue().encode())
