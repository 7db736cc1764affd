"""Products of numbers of 16 bits, in pairs or tiles: the time they could save, and the accuracy they would cost.

python benchmarks/pair_products.py times      results/pair_products_times.csv
python benchmarks/pair_products.py errors     results/pair_products_errors.csv
python benchmarks/pair_products.py tuned      results/pair_products_tuned.csv: after further training

Times are those of `runtimes.py`, in turn on one core, but CPU times. The *bound* of a super step is its time in C, with the
time of its float32 products replaced by that of the products alone: roundings and conversions come on top. *Over physics*
is the time of the physics in C over the bound.

For the errors, the weights of hidden layers and what these are multiplied with are rounded, to bfloat16, or as int16: to 12
bits and a sign, of the largest of a column and of the largest input of a layer, so that no sum of 127 products overflows 32
bits. States, the last layer, the linear map beside it and sums stay float32; in *all* only states and sums do.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from runtimes import SUBSTEPS, timed
from runtimes_cases import generated_c, physics_in_c, roofline
from runtimes_cases.case import BATCHES, SUPER_STEP, Motion, batch_task

from neuroanimator import Emulator, load_emulator, set_backend
from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.emulator.networks.gated import Gated, GatedNetwork
from neuroanimator.emulator.networks.glu import Glu
from neuroanimator.emulator.networks.mirrored import Mirrored
from neuroanimator.evaluation.accuracy import one_step_error, rollout_error, root_mean_square
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.held_out import held_out_runs
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.speed import one_core
from neuroanimator.terminal import print_table
from neuroanimator.training.chunk import completed
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.lesson import lesson_of
from neuroanimator.training.optimizer import make_optimizer

RESULTS = Path(__file__).parent / "results"

SYSTEMS = ("pendulum", "lander", "fish", "dolphin")

ROUNDS = 60

TASKS = (SUPER_STEP, batch_task(BATCHES[-1]))

SETS = 2
"""Sets of held-out runs."""

STEPS = 100
"""Super steps of each run."""

SCALING = 100
"""Super steps by which factors of int16 are scaled."""

HEADROOM = 2.0
"""Largest input of int16 over the largest in these super steps; larger ones are clipped."""

TINY = 1e-30

LARGEST = 2**12 - 1
"""Magnitude of a factor of int16: the products of two have 24 bits, so that 127 fit into 31."""

TUNED = "pendulum"
"""System of the emulator that is trained further, a network of gated layers."""

TRANSITIONS = 40_000
UPDATES = 4_000
LEARNING_RATE = 1e-3
"""Of further training, with and without rounding."""


def times(systems: list[str], rounds: int) -> list[dict[str, Any]]:
    """Return the times of C, of all kinds of products and of the physics, and the bounds that follow."""
    rows = []
    for system in systems:
        motion = Motion(load_emulator(f"{system}-{SUBSTEPS}"))
        with one_core():
            cases = [
                case._replace(run=partial(cpu_seconds, case.run))
                for runtime in (generated_c, physics_in_c, roofline)
                for case in runtime.cases(motion)
                if case.task in TASKS and "emulator." not in case.runtime
            ]
            timings = timed(f"{system}-{SUBSTEPS}", cases, rounds)
        for task in TASKS:
            taken = {row["runtime"]: row["p50_ns"] for row in timings if row["task"] == task}
            rows += _bounds(f"{system}-{SUBSTEPS}", task, taken)
    return rows


def cpu_seconds(run: Callable[[], Any]) -> float:
    """Return the CPU time of a run [s]: other work on the machine makes it longer, but by far less than the time."""
    began = time.process_time()
    run()
    return time.process_time() - began


def _bounds(name: str, task: str, taken: dict[str, float]) -> list[dict[str, Any]]:
    """Return a row for each runtime of one task, from their times [ns]."""
    physics = [span for runtime, span in taken.items() if runtime.startswith(physics_in_c.NAME)]
    rows = []
    for runtime, span in taken.items():
        row: dict[str, Any] = {"emulator": name, "task": task, "runtime": runtime, "p50_ns": span}
        row |= {"bound_ns": "", "speed_up": "", "over_physics": ""}
        bound = None
        if runtime == generated_c.NAME:
            bound = span
        elif runtime in (*roofline.PAIRS, roofline.TILES):
            bound = taken[generated_c.NAME] - taken[roofline.NAME] + span
        if bound is not None:
            row["bound_ns"] = bound
            row["speed_up"] = taken[generated_c.NAME] / bound
            if physics:
                row["over_physics"] = physics[0] / bound
        rows.append(row)
    return rows


class RoundedMatrix(eqx.Module):
    """A matrix of weights whose products have factors of 16 bits, with the gradient of products without rounding."""

    weights: Float[Array, "I K"]
    most: float | None = eqx.field(static=True)
    """Largest input, for int16; None for bfloat16."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the matrix."""
        return self.weights.shape

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.weights, dtype)

    def __rmatmul__(self, inputs: Float[Array, " I"]) -> Float[Array, " K"]:
        if self.most is None:
            return as_bfloat16(inputs) @ as_bfloat16(self.weights)
        largest = jnp.maximum(jnp.abs(self.weights).max(axis=0), TINY)
        return as_int16(inputs, self.most) @ as_int16(self.weights, largest)


class WatchedMatrix(eqx.Module):
    """A matrix of weights that notes the largest magnitude it is multiplied with."""

    weights: Float[Array, "I K"]
    largest: list[float] = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the matrix."""
        return self.weights.shape

    def __rmatmul__(self, inputs: Float[Array, " I"]) -> Float[Array, " K"]:
        self.largest[0] = max(self.largest[0], float(jnp.abs(inputs).max()))
        return inputs @ self.weights


def as_bfloat16(numbers: Float[Array, " ..."]) -> Float[Array, " ..."]:
    """Return the nearest numbers of bfloat16, with gradient one."""
    return straight_through(numbers, jax.lax.reduce_precision(numbers, 8, 7))


def as_int16(numbers: Float[Array, " ..."], most: Any) -> Float[Array, " ..."]:
    """Return the nearest of `LARGEST` numbers up to `most`, and as many below zero, with gradient one."""
    unit = most / LARGEST
    return straight_through(numbers, jnp.clip(jnp.round(numbers / unit), -LARGEST, LARGEST) * unit)


def straight_through(
    numbers: Float[Array, " ..."], rounded: Float[Array, " ..."]
) -> Float[Array, " ..."]:
    """Return `rounded` with the gradient of `numbers`."""
    return numbers + jax.lax.stop_gradient(rounded - numbers)


def hidden_matrices(emulator: Emulator) -> list[Any]:
    """Return the weights of all hidden layers."""
    network = emulator.network
    if isinstance(network, GatedNetwork):
        return [matrix for layer in network.layers for matrix in (layer.odd_in, layer.even_in)]
    assert isinstance(network, Glu)
    return list(network.layers)


def all_matrices(emulator: Emulator) -> list[Any]:
    """Return the weights of all layers, and of the linear map beside them."""
    network = emulator.network
    last = [network.out] if isinstance(network, (Gated, Glu)) else []
    if isinstance(network, Mirrored):
        last = [network.odd_out, network.even_out, network.odd_linear, network.even_linear]
    return hidden_matrices(emulator) + last


Matrices = Callable[[Emulator], list[Any]]
"""Which weights of an emulator are rounded."""


def with_bfloat16(emulator: Emulator, matrices: Matrices = hidden_matrices) -> Emulator:
    """Return `emulator` with `matrices` of bfloat16."""
    return eqx.tree_at(matrices, emulator, replace_fn=lambda weights: RoundedMatrix(weights, None))


def with_int16(emulator: Emulator, matrices: Matrices = hidden_matrices) -> Emulator:
    """Return `emulator` with `matrices` of int16, scaled by the largest inputs in some unseen super steps."""
    watched = eqx.tree_at(
        matrices, emulator, replace_fn=lambda weights: WatchedMatrix(weights, [0.0])
    )
    states, controls, _ = held_out_runs(emulator).transitions
    for number in range(0, len(states), len(states) // SCALING):
        latent = watched.encode(jnp.asarray(states[number], jnp.float32))
        control = watched.encode_control(jnp.asarray(controls[number], jnp.float32))
        watched.step_latent(latent, control)
    rounded = []
    for weights, noted in zip(matrices(emulator), matrices(watched), strict=True):
        rounded.append(RoundedMatrix(weights, HEADROOM * noted.largest[0]))
    return eqx.tree_at(matrices, emulator, rounded)


ROUNDINGS: dict[str, Callable[[Emulator], Emulator]] = {
    "float32": lambda emulator: emulator,
    "bfloat16": with_bfloat16,
    "bfloat16, all": partial(with_bfloat16, matrices=all_matrices),
    "int16": with_int16,
    "int16, all": partial(with_int16, matrices=all_matrices),
}


def errors(systems: list[str]) -> list[dict[str, Any]]:
    """Return the errors of shipped emulators as they are and rounded."""
    rows = []
    for system in systems:
        emulator = load_emulator(f"{system}-{SUBSTEPS}")
        rounded = {name: rounding(emulator) for name, rounding in ROUNDINGS.items()}
        rows += error_rows(f"{system}-{SUBSTEPS}", rounded)
    return rows


def error_rows(name: str, emulators: dict[str, Emulator]) -> list[dict[str, Any]]:
    """Return the errors of each of `emulators`, by their numbers, and over those of the first, on the same runs."""
    one = next(iter(emulators.values()))
    tests = [
        held_out_runs(one, seconds=STEPS * one.dt, seed=seed)
        for seed in range(1, SETS + 1)  # int16 is scaled by set 0
    ]
    rows: list[dict[str, Any]] = []
    for numbers, emulator in emulators.items():
        measured: dict[str, list[float]] = {"one_step": [], "after_1s": [], "over_100": []}
        for test in tests:
            measured["one_step"].append(float(root_mean_square(one_step_error(emulator, test))))
            emulated = emulator.rollout(test.states[:, 0], test.controls, may_diverge=True)
            over_time = rollout_error(test.frame, np.asarray(emulated, float), test.states)
            measured["after_1s"].append(float(over_time[round(1 / one.dt)]))
            measured["over_100"].append(float(root_mean_square(over_time)))
        row: dict[str, Any] = {"emulator": name, "numbers": numbers}
        for key, values in measured.items():
            row[key] = float(np.mean(values))
            row[f"{key}_ratio"] = row[key] / (rows[0][key] if rows else row[key])
        rows.append(row)
    return rows


def tuned(updates: int) -> list[dict[str, Any]]:
    """Return the errors of one emulator after further training with and without rounding, and as it was."""
    emulator = load_emulator(f"{TUNED}-{SUBSTEPS}")
    data = simulate_transitions(
        DatasetConfig(system=TUNED, substeps=SUBSTEPS, count=TRANSITIONS, seed=1)
    )
    config = TrainingConfig(
        network="gated",
        widths=emulator.network.widths,
        updates=updates,
        learning_rate=LEARNING_RATE,
    )
    return error_rows(
        f"{TUNED}-{SUBSTEPS}",
        {
            "float32, trained further": trained(emulator, data, config),
            "bfloat16, trained further": trained(with_bfloat16(emulator), data, config),
            "float32": emulator,
            "bfloat16": with_bfloat16(emulator),
        },
    )


def trained(emulator: Emulator, data: Any, config: TrainingConfig) -> Emulator:
    """Return `emulator` after `config.updates` updates on `data`."""
    lesson = lesson_of(data, config, emulator)
    network = emulator.network
    state = make_optimizer(config).init(network)
    with closing(lesson.feed):
        for chunk in range(config.chunks):
            network, state, _ = lesson.feed.train(network, state, chunk)
    return completed(lesson.problem.base, network, lesson.problem.rest)


def main() -> None:
    """Measure one of three tables, print it and write it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", choices=("times", "errors", "tuned"))
    parser.add_argument("--systems", nargs="*", default=SYSTEMS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--updates", type=int, default=UPDATES)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the tables")
    options = parser.parse_args()
    if options.table == "times":
        rows = times(options.systems, options.rounds)
    else:
        set_backend("jax")  # both sides alike: generated C rounds nothing
        rows = errors(options.systems) if options.table == "errors" else tuned(options.updates)
    options.out.mkdir(parents=True, exist_ok=True)
    write_csv(options.out / f"pair_products_{options.table}.csv", rows)
    print(describe_machine())
    print_table(rows)


if __name__ == "__main__":
    main()
