"""Runtimes of an emulator: C, JAX, WebAssembly and ONNX, C written by hand as the limit, and a swimmer's physics in C.

python -m benchmarks.super_steps.runtimes  all systems: runtimes.csv and runtimes_sizes.csv
python -m benchmarks.super_steps.runtimes --systems fish --rounds 20 --out /tmp/try

Everything runs on one core, all cases of an emulator in turn, in float32 and from rest under random controls. Times are
nanoseconds per super step: the median and the 99th percentile of all rounds, without compilation. A rollout has 200 super
steps, a gradient is J and its gradient over 100, as in a descent (in node: the gradient of the last state with respect to all
before), and motions in batches make ten each. Exports, and code written by hand, are checked against JAX before they are
timed. `emulator.step` and `emulator.rollout` are called as by users. share_of_roofline is the time of the products with its
weights alone, in float32 from their place in memory, over that of C.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.harness import Rows, keep_rows, parser_of, show_rows
from benchmarks.super_steps import (
    c_by_hand,
    generated_c,
    jax_compiled,
    onnx_in_onnxruntime,
    physics_in_c,
    roofline,
    wasm_in_node,
)
from benchmarks.super_steps.case import Case, Motion
from neuroanimator import load_emulator, write_c_header, write_onnx, write_wasm
from neuroanimator.learn.evaluation.speed import one_core
from neuroanimator.terminal import progress_bar

SYSTEMS = ("pendulum", "pendulum-passive", "truck", "lander", "fish", "dolphin")

SUBSTEPS = 50

RESULTS = Path(__file__).parent

ROUNDS = 200
"""Number of timings of every case."""

WRITERS = {"h": write_c_header, "wasm": write_wasm, "onnx": write_onnx}
"""What is exported, by the end of the file's name."""


def exported(motion: Motion, folder: Path) -> dict[str, Any]:
    """Write all exports to `folder`, where they are held against JAX, and return their sizes [kB]."""
    sizes: dict[str, Any] = {}
    for suffix, write in WRITERS.items():
        file = folder / f"it.{suffix}"
        write(motion.emulator, file)
        sizes[f"{suffix}_kB"] = file.stat().st_size / 1e3
    return sizes


def cases_of(motion: Motion, folder: Path, stack: ExitStack) -> Iterator[Case]:
    """Yield every case of one emulator, whose exports are in `folder`; what they start ends with the `stack`."""
    yield from generated_c.cases(motion)
    yield from c_by_hand.cases(motion)
    yield from jax_compiled.cases(motion)
    yield from wasm_in_node.cases(motion, folder, stack)
    yield from onnx_in_onnxruntime.cases(motion, folder / "it.onnx")
    yield from physics_in_c.cases(motion)
    yield from roofline.cases(motion)


def timed(name: str, cases: list[Case], rounds: int) -> Rows:
    """Return a row for each case, all of them run in turn."""
    spans: list[list[float]] = [[] for _ in cases]
    for case in cases:
        case.run()  # compiles
    with progress_bar(f"timing {name}", rounds) as bar:
        for done in range(1, rounds + 1):
            for case, taken in zip(cases, spans, strict=True):
                taken.append(seconds_of(case))
            bar.advance_to(done)
    rows = []
    for case, taken in zip(cases, spans, strict=True):
        nanoseconds = np.array(taken) / case.steps * 1e9
        row: dict[str, Any] = {"emulator": name, "task": case.task, "runtime": case.runtime}
        row["p50_ns"] = float(np.percentile(nanoseconds, 50))
        row["p99_ns"] = float(np.percentile(nanoseconds, 99))
        rows.append(row)
    least = {row["task"]: row["p50_ns"] for row in rows if row["runtime"] == roofline.NAME}
    for row in rows:
        has_roof = row["runtime"] == generated_c.NAME and row["task"] in least
        row["share_of_roofline"] = least[row["task"]] / row["p50_ns"] if has_roof else ""
    return sorted(rows, key=lambda row: row["task"])


def seconds_of(case: Case) -> float:
    """Return how long one run takes [s]."""
    began = time.perf_counter()
    measured = case.run()
    took = time.perf_counter() - began
    return measured if isinstance(measured, float) else took


def main() -> None:
    """Time all systems, print the tables and write them."""
    parser = parser_of(__doc__)
    parser.add_argument("--systems", nargs="*", default=SYSTEMS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the tables")
    options = parser.parse_args()
    rows: Rows = []
    sizes: Rows = []
    with progress_bar("emulators", len(options.systems)) as bar:
        for done, system in enumerate(options.systems):
            name = f"{system}-{SUBSTEPS}"
            motion = Motion(load_emulator(name))
            with TemporaryDirectory() as made:
                folder = Path(made)
                bar.advance_to(done, f"{name}: exporting")
                sizes.append({"emulator": name, **exported(motion, folder)})
                bar.advance_to(done, f"{name}: compiling and timing")
                with one_core(), ExitStack() as stack:
                    cases = list(cases_of(motion, folder, stack))
                    rows += timed(name, cases, options.rounds)
            bar.advance_to(done + 1, name)
    show_rows(rows)
    show_rows(sizes)
    keep_rows(options.out / "runtimes.csv", rows, options)
    keep_rows(options.out / "runtimes_sizes.csv", sizes, options)


if __name__ == "__main__":
    main()
