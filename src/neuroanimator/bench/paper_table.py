"""The table of 1998, measured again: every system, every n, accuracy and both speed-ups."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.codegen.c_emulator import CEmulator
from neuroanimator.data.config import RUN_STEPS, DatasetConfig
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.emulator import Emulator, rollout
from neuroanimator.evaluation.accuracy import (
    held_out_runs,
    one_step_error,
    root_mean_square,
    system_of,
)
from neuroanimator.evaluation.evaluate import THOROUGH, Effort, Evaluation, evaluate
from neuroanimator.evaluation.speed import (
    IN_C,
    IN_JAX,
    PHYSICS_STEPS,
    compiled,
    interleaved,
    one_core,
    program_in_c,
)
from neuroanimator.evaluation.speed_mass_spring import BATCH_STEPS, c_batch_players
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.training.config import UPDATES_PER_CHUNK
from neuroanimator.training.recipes import RECIPES

NOMINAL_1998 = {
    ("pendulum-passive", 25): 47, ("pendulum-passive", 50): 94, ("pendulum-passive", 100): 235,
    ("pendulum", 25): 38, ("pendulum", 50): 75, ("pendulum", 100): 151,
    ("truck", 50): 70, ("lander", 50): 54, ("dolphin", 50): 66,
}  # fmt: skip
"""Speed-ups in Table 1 of the seminar paper: times for 20,000 physics steps, divided."""

BATCHES = (64, 1024)
CALLS = 2_000
BASELINE_EXAMPLES = 7_200
"""Transitions the ridge regression is fitted to: far more than it has numbers."""


@dataclass(frozen=True)
class TableRow:
    """One system at one n: a row's figures, and the evaluations they are medians of."""

    figures: dict[str, Any]
    evaluations: list[Evaluation]


def measure_row(
    emulators: list[Emulator], chunk_seconds: float, effort: Effort = THOROUGH
) -> TableRow:
    """Return the row of emulators that differ in their training seed alone, each tested on runs of its own.

    There are at least `effort.rounds` rounds of unseen runs and timings, so that there are quartiles of both.
    `chunk_seconds` is what a chunk of training takes here, for the break-even.
    """
    shipped = emulators[0]
    examples = few_transitions(shipped)
    again = replace(effort, starts=0)  # blow-ups are counted once
    found = [
        evaluate(
            emulators[seed % len(emulators)],
            data=examples,
            effort=again if seed else effort,
            seed=seed,
        )
        for seed in range(max(effort.rounds, len(emulators)))
    ]
    rows, program = [each.row() for each in found], program_in_c(shipped)
    medians = {key: _middle([row[key] for row in rows]) for key in rows[0]}
    first = found[0]
    figures = {
        **medians,
        "nominal_quartiles": quartiles([each.speed.nominal for each in found]),
        "nominal_tuned_c": _nominal_tuned(first),
        "nominal_1998": NOMINAL_1998.get((first.system, first.substeps), ""),
        "one_step_quartiles": quartiles([each.one_step_error for each in found]),
        "one_step_error_shifted": shifted_error(shipped, effort),
        "rollout_error_5s": float(np.median([each.rollout_error_at(5.0) for each in found])),
        "self_divergence_1s": divergence_at(first, 1.0),
        "self_divergence_5s": divergence_at(first, 5.0),
        **{f"{name.replace(' ', '_')}_error": error for name, error in first.baselines.items()},
        "physics_s_for_20000_steps": first.speed.physics_seconds * PHYSICS_STEPS,
        "emulator_s_for_20000_steps": first.emulator_seconds * PHYSICS_STEPS / first.substeps,
        "break_even_hours": break_even_hours(shipped, first, chunk_seconds),
        "seeds": len(emulators),
        "rounds": len(found),
        "diverged": sum(each.diverged for each in found),
        "blow_up_starts": sum(each.diverged_starts for each in found),
        **latency(shipped),
        **{
            f"us_in_batch_{batch}": batch_microseconds(shipped, program, batch) for batch in BATCHES
        },
        **{
            f"physics_us_in_batch_{batch}": physics_batch_microseconds(shipped, batch)
            for batch in BATCHES
        },
    }
    return TableRow(figures, found)


def _nominal_tuned(evaluation: Evaluation) -> float | str:
    """Return the nominal speed-up against C made for this one body; empty where there is no such opponent."""
    tuned, speed = evaluation.speed.tuned_seconds, evaluation.speed
    return "" if tuned is None else tuned * evaluation.substeps / speed.emulator_seconds


def _middle(values: list[Any]) -> Any:
    """Return the median of numbers, and the first text where there is one."""
    texts = [value for value in values if not isinstance(value, float)]
    return texts[0] if texts else float(np.median(values))


def quartiles(values: list[float]) -> str:
    """Return the quartiles of `values`, such as `92.1-96.3`."""
    low, high = np.percentile(values, [25, 75])
    return f"{low:.3g}-{high:.3g}"


def few_transitions(emulator: Emulator) -> Transitions:
    """Return enough transitions of the emulator's system to fit cheap predictors to."""
    spec = emulator.spec
    return simulate_transitions(
        DatasetConfig(
            system=spec.system,
            definition=spec.definition,
            substeps=spec.substeps,
            count=BASELINE_EXAMPLES,
            samples_per_run=36,
        )
    )


def shifted_error(emulator: Emulator, effort: Effort) -> float:
    """Return the one-step error under controls training hardly saw: full range, another at every super step."""
    test = held_out_runs(
        emulator, count=effort.runs, seconds=RUN_STEPS * emulator.dt, is_shifted=True
    )
    return float(root_mean_square(one_step_error(emulator, test)))


def divergence_at(evaluation: Evaluation, seconds: float) -> float:
    """Return how far the physics at its own step has strayed from fine physics after `seconds` [s]."""
    assert evaluation.self_divergence is not None
    return float(
        evaluation.self_divergence[
            min(round(seconds / evaluation.dt), len(evaluation.self_divergence) - 1)
        ]
    )


def break_even_hours(emulator: Emulator, evaluation: Evaluation, chunk_seconds: float) -> float:
    """Return after how much simulated time [h] the emulator has saved what its data and training cost.

    Both are estimated from this machine's own speed: physics steps of the teacher, and a timed stretch of training.
    """
    recipe, speed, system = RECIPES[evaluation.system], evaluation.speed, system_of(emulator)
    runs = recipe.data(evaluation.system, evaluation.substeps).runs
    per_step = next(
        o.seconds for o in speed.opponents if o.scheme == system.truth
    ) / system.truth.steps(emulator.dt)
    data_seconds = runs * RUN_STEPS * system.truth.steps(emulator.dt) * per_step
    training_seconds = (
        chunk_seconds * recipe.training(evaluation.substeps).updates / UPDATES_PER_CHUNK
    )
    saved = (speed.physics_seconds * evaluation.substeps - speed.emulator_seconds) / emulator.dt
    return (data_seconds + training_seconds) / saved / 3600


def latency(emulator: Emulator) -> dict[str, float]:
    """Return the 50th and 99th percentile of one super step called from Python [µs]: mostly the call."""
    step = emulator.step
    state, control = jnp.asarray(emulator.rest), jnp.zeros(emulator.control.size)
    spans = []
    with one_core():
        step(state, control).block_until_ready()  # compiles
        for _ in range(CALLS):
            began = time.perf_counter()
            step(state, control).block_until_ready()
            spans.append((time.perf_counter() - began) * 1e6)
    return {
        "call_p50_us": float(np.percentile(spans, 50)),
        "call_p99_us": float(np.percentile(spans, 99)),
    }


def batch_microseconds(
    emulator: Emulator, program: CEmulator | None, batch: int, steps: int = 400, repeats: int = 5
) -> float:
    """Return the time per trajectory and super step [µs] of a batch on one core: side by side in JAX, or in turn in C.

    The faster counts; `program` is the emulator in C, if there is one: it keeps the last states only, as physics does.
    """
    run = compiled(emulator, jax.vmap(rollout, (None, 0, 0)))
    states = jnp.tile(jnp.asarray(emulator.rest), (batch, 1))
    controls = jnp.tile(jnp.asarray(emulator.bounds.middle, jnp.float32), (batch, steps, 1))
    run(states, controls).block_until_ready()
    players: dict[str, Callable[[], Any]] = {
        IN_JAX: lambda: run(states, controls).block_until_ready()
    }
    if program is not None:
        one = program.player(
            *(np.asarray(each) for each in emulator.encode_motion(states[0], controls[0]))
        )
        players[IN_C] = lambda: [one() for _ in range(batch)]
    with one_core():
        spans = interleaved(players, repeats)
    return min(spans.values()) / (batch * steps) * 1e6


def physics_batch_microseconds(emulator: Emulator, batch: int) -> float | str:
    """Return the C twin's time per body and physics step [µs] in a batch on one core, by its fastest layout.

    Empty for rigid bodies, which MuJoCo steps one after another, and where there is no compiler.
    """
    system = system_of(emulator)
    if not isinstance(system, DeformableSystem):
        return ""
    players = c_batch_players(system, batch, system.scheme.integrator)
    with one_core():
        spans = interleaved(players)
    return min(spans.values()) / (batch * BATCH_STEPS) * 1e6 if spans else ""
