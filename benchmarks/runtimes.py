"""What runs an emulator: generated C beside JAX, one core, interleaved in one process.

python benchmarks/runtimes.py            table, and results/runtimes.csv (two minutes)

`rollout_*` is `emulator.rollout` of 200 super steps and `step_*` is `emulator.step`, as users call them from Python;
`kernel_c` is the same rollout without Python around it. `gradient_c` is J and its gradient over 100 super
steps, as a descent asks for it, and `batch_*` what one motion of many costs. Times are nanoseconds a super step, but
for `step_*`, which are microseconds a call.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator import Emulator, load_emulator, set_backend
from neuroanimator.bench.csv_table import describe_machine, write_csv
from neuroanimator.control.descent.c_evaluator import c_evaluator
from neuroanimator.control.descent.descend import pose_problem
from neuroanimator.control.descent.parametrisation import EachStep
from neuroanimator.control.objective.costs import effort, stay_within
from neuroanimator.control.objective.objective import Objective
from neuroanimator.emulator.c_emulator import c_emulator
from neuroanimator.errors import ResourceError
from neuroanimator.evaluation.speed import one_core
from neuroanimator.systems import load_system
from neuroanimator.terminal import print_table, progress_bar

SYSTEMS = ("pendulum", "pendulum-passive", "truck", "lander", "fish", "dolphin", "cube")
STEPS = 200
GRADIENT_STEPS = 100
BATCHES = (16, 64, 1024)
BATCH_STEPS = 10
REPEATS = 15
"""Each call is timed so often, all in turn; the medians are told, and the 99th percentile of one call."""
CONTROLS = 0.3
"""Random controls of at most this share of their range."""

Call = Callable[[], Any]


def in_backend(name: str, call: Call) -> Call:
    """Return `call` by the backend `name`."""

    def called() -> Any:
        set_backend(name)
        return call()

    return called


def calls_of(emulator: Emulator) -> dict[str, tuple[Call, int]]:
    """Return, by name, (a call, super steps it takes)."""
    rng = np.random.default_rng(0)
    bounds = emulator.bounds
    shares = rng.uniform(-CONTROLS, CONTROLS, (STEPS, len(bounds.half)))
    controls = np.asarray(bounds.middle + shares * bounds.half, np.float32)
    rest = emulator.rest.astype(np.float32)
    program = c_emulator(emulator)
    if program is None:
        raise ResourceError("runtimes: there is no program in C here. Install a C compiler.")
    rollout = partial(emulator.rollout, rest, controls)
    step = partial(emulator.step, rest, controls[0])
    calls: dict[str, tuple[Call, int]] = {
        "kernel_c": (partial(program.rollout, rest, controls), STEPS),
        "rollout_c": (in_backend("c", rollout), STEPS),
        "rollout_jax": (in_backend("jax", rollout), STEPS),
        "step_c": (in_backend("c", step), 1),
        "step_jax": (in_backend("jax", step), 1),
    }
    varied = EachStep.of(GRADIENT_STEPS, bounds)
    system = load_system(emulator.spec.system)
    nearly_still = stay_within(system, system.state.slices[0].name, -1.0, 1.0, within=1.0)
    problem = pose_problem(emulator, Objective.of(effort(), nearly_still), varied, rest)
    evaluator = c_evaluator(problem)
    if evaluator is None:
        raise ResourceError("runtimes: there is no descent in C here.")
    gradient = partial(evaluator.gradients, np.zeros((1, varied.size)))
    calls["gradient_c"] = (gradient, GRADIENT_STEPS)
    for batch in BATCHES:
        starts = np.tile(rest, (batch, 1))
        many = np.tile(controls[:BATCH_STEPS], (batch, 1, 1))
        together = partial(emulator.rollout, starts, many)
        calls[f"batch_{batch}_c"] = (in_backend("c", together), batch * BATCH_STEPS)
        calls[f"batch_{batch}_jax"] = (in_backend("jax", together), batch * BATCH_STEPS)
    return calls


def row(name: str) -> dict[str, Any]:
    """Return the times of one emulator."""
    calls = calls_of(load_emulator(name))
    spans: dict[str, list[float]] = {name: [] for name in calls}
    for call, _ in calls.values():
        call()  # compiles
    for _ in range(REPEATS):
        for label, (call, _) in calls.items():
            began = time.perf_counter()
            call()
            spans[label].append(time.perf_counter() - began)
    result: dict[str, Any] = {"emulator": name}
    for label, (_, steps) in calls.items():
        unit = 1e6 if label.startswith("step") else 1e9
        result[label] = float(np.median(spans[label])) / steps * unit
    result["rollout_c_p99"] = float(np.percentile(spans["rollout_c"], 99)) / STEPS * 1e9
    result["speed_of_kernel_kept"] = result["kernel_c"] / result["rollout_c"]
    result["jax_over_c"] = result["rollout_jax"] / result["rollout_c"]
    return result


def main() -> None:
    rows = []
    with one_core(), progress_bar("emulators", len(SYSTEMS)) as bar:
        for done, system in enumerate(SYSTEMS, start=1):
            rows.append(row(f"{system}-50"))
            bar.advance_to(done, system)
    folder = Path(__file__).parent / "results"
    write_csv(folder / "runtimes.csv", rows)
    print(describe_machine())
    print_table(rows)


if __name__ == "__main__":
    main()
