"""Accuracy and speed of the shipped pendulum emulators: the 1998 table, against MuJoCo in C.

python benchmarks/pendulum.py            table, and results/pendulum.csv
python benchmarks/pendulum.py --json     rows as JSON
python benchmarks/pendulum.py --quick    n = 50 only, fewer repeats
"""

from __future__ import annotations

import argparse
import json
import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from machine import describe_machine, write_results

from neuroanimator import Emulator, find_emulator
from neuroanimator.emulator.emulator import rollout
from neuroanimator.evaluation.accuracy import count_blow_ups, held_out_runs, one_step_error, root_mean_square
from neuroanimator.evaluation.evaluate import evaluate
from neuroanimator.evaluation.speed import measure_speed, one_core
from neuroanimator.shipped import SHIPPED
from neuroanimator.terminal import print_table

BLOW_UP_STARTS, BLOW_UP_STEPS = 1_000, 10_000
SEEDS = 5
"""Rounds of unseen runs and timings: medians and quartiles come from these."""
BATCHES = (64, 1024)


def measure(name: str, seeds: int) -> dict[str, str | int | float]:
    """Return one row: medians over `seeds` rounds, quartiles of what varies."""
    emulator = Emulator.load(find_emulator(name))
    rounds = [_round(emulator, seed) for seed in range(seeds)]
    middle = {key: float(np.median([each[key] for each in rounds])) for key in rounds[0]}
    low, high = np.percentile([each["nominal_speedup"] for each in rounds], [25, 75])
    first = evaluate(emulator, starts=0)
    return {
        "system": emulator.identity.system,
        "substeps": emulator.identity.substeps,
        **middle,
        "nominal_quartiles": f"{low:.1f}-{high:.1f}",
        "equal_error_rival": first.row()["equal_error_rival"],
        "rollout_error_1s": first.rollout_error_at(1.0),
        "self_divergence_1s": float(first.self_divergence[round(1.0 / emulator.dt)]),
        "blow_ups": count_blow_ups(emulator, BLOW_UP_STARTS, BLOW_UP_STEPS),
        **_latency(emulator),
        **{f"us_in_batch_{batch}": _batch_microseconds(emulator, batch) for batch in BATCHES},
    }


def _round(emulator: Emulator, seed: int) -> dict[str, float]:
    test = held_out_runs(emulator, seed=seed)
    error = float(root_mean_square(one_step_error(emulator, test)))
    speed = measure_speed(emulator, test, error)
    return {
        "one_step_error": error,
        "nominal_speedup": speed.nominal,
        "equal_error_speedup": speed.equal_error,
        "emulator_us": speed.emulator_seconds * 1e6,
        "physics_us": speed.physics_seconds * 1e6,
    }


def _latency(emulator: Emulator, calls: int = 2_000) -> dict[str, float]:
    """Return the 50th and 99th percentile of one super step called from Python [µs]: mostly the call."""
    step, arrays = _compiled(emulator, lambda model, state, control: model.step(state, control))
    state, control = jnp.zeros(emulator.identity.state.size), jnp.zeros(emulator.identity.control.size)
    spans = []
    with one_core():
        for _ in range(calls):
            began = time.perf_counter()
            step(arrays, state, control).block_until_ready()
            spans.append((time.perf_counter() - began) * 1e6)
    return {"call_p50_us": float(np.percentile(spans, 50)), "call_p99_us": float(np.percentile(spans, 99))}


def _batch_microseconds(emulator: Emulator, batch: int, steps: int = 400, repeats: int = 5) -> float:
    """Return the time per trajectory and super step [µs] of a batch on one core."""
    run, arrays = _compiled(
        emulator, lambda model, state, control: jax.vmap(rollout, (None, 0, 0))(model, state, control)
    )
    states = jnp.zeros((batch, emulator.identity.state.size))
    controls = jnp.zeros((batch, steps, emulator.identity.control.size)) + 0.1
    run(arrays, states, controls).block_until_ready()
    spans = []
    with one_core():
        for _ in range(repeats):
            began = time.perf_counter()
            run(arrays, states, controls).block_until_ready()
            spans.append(time.perf_counter() - began)
    return float(np.median(spans)) / (batch * steps) * 1e6


def _compiled(emulator: Emulator, function):
    arrays, rest = eqx.partition(emulator, eqx.is_array)
    return jax.jit(lambda arrays, *inputs: function(eqx.combine(arrays, rest), *inputs)), arrays


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print rows as JSON")
    parser.add_argument("--quick", action="store_true", help="n = 50 only, one round; writes no file")
    options = parser.parse_args()
    names = [f"{system}-{n}" for system, n in sorted(SHIPPED) if n == 50 or not options.quick]
    rows = []
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        rows.append(measure(name, seeds=1 if options.quick else SEEDS))
    if not options.quick:
        write_results("pendulum.csv", rows)
    if options.json:
        print(json.dumps(rows, indent=2))
    else:
        print(describe_machine())
        print_table(rows)


if __name__ == "__main__":
    main()
