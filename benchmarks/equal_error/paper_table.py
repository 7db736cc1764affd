"""The table of 1998, measured again: every system, every n, accuracy and both speed-ups."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.equal_error.batch_players import BATCH_STEPS, c_batch_players, random_bodies
from benchmarks.equal_error.plain_mass_spring import plain_player
from benchmarks.harness import quartiles
from neuroanimator.emulator.c_emulator import CEmulator
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.runner import program_of
from neuroanimator.emulator.super_step import rollout
from neuroanimator.learn.data.config import RUN_STEPS, DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.accuracy import one_step_error, root_mean_square
from neuroanimator.learn.evaluation.evaluate import THOROUGH, Evaluation, EvaluationBudget, evaluate
from neuroanimator.learn.evaluation.held_out import held_out_runs, make_test, system_of
from neuroanimator.learn.evaluation.speed import (
    IN_C,
    IN_JAX,
    PHYSICS_STEPS,
    PIECES,
    TIMED_SUPER_STEPS,
    compiled,
    emulator_players,
    interleaved,
    one_core,
)
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK
from neuroanimator.learn.training.recipes import RECIPES
from neuroanimator.physics.deformable.deformable_system import DeformableSystem

NOMINAL_1998 = {
    ("pendulum-passive", 25): 47,
    ("pendulum-passive", 50): 94,
    ("pendulum-passive", 100): 235,
    ("pendulum", 25): 38,
    ("pendulum", 50): 75,
    ("pendulum", 100): 151,
    ("truck", 50): 70,
    ("lander", 50): 54,
    ("dolphin", 50): 66,
}
"""Speed-ups in Table 1 of the seminar paper: times for 20,000 physics steps, divided."""

PLAIN_C = "plain C"
"""Name of the opponent of deformable bodies that reads them from tables."""

BATCHES = (64, 1024)
"""Numbers of trajectories in the batches timed."""

BATCH_SUPER_STEPS = 400
"""Length of a trajectory of a batch [super steps]."""

BATCH_REPEATS = 5
"""Number of timings of a batch; the least counts."""

CALLS = 2_000
"""Number of calls from Python timed one by one."""

BASELINE_EXAMPLES = 7_200
"""Number of transitions the ridge regression is fitted to: far more than it has numbers."""

BASELINE_SAMPLES = 36
"""Number of them from each simulated run."""


@dataclass(frozen=True)
class TableRow:
    """One system at one n: a row's figures, and the evaluations they are medians of."""

    figures: dict[str, Any]
    evaluations: list[Evaluation]


def measure_row(
    emulators: list[Emulator], chunk_seconds: float, budget: EvaluationBudget = THOROUGH
) -> TableRow:
    """Return the row of emulators that differ in their training seed alone, each tested on runs of its own.

    There are at least `budget.rounds` rounds of unseen runs and timings, so that there are quartiles of both.
    `chunk_seconds` is what a chunk of training takes here, for the break-even.
    """
    shipped = emulators[0]
    evaluations = _evaluations(emulators, budget)
    first = evaluations[0]
    figures = _medians(evaluations)
    figures |= _accuracy_figures(shipped, evaluations, budget)
    figures |= {
        "physics_s_for_20000_steps": first.speed.physics_seconds * PHYSICS_STEPS,
        "emulator_s_for_20000_steps": first.emulator_seconds * PHYSICS_STEPS / first.substeps,
        "break_even_hours": break_even_hours(shipped, first, chunk_seconds),
        "seeds": len(emulators),
        "rounds": len(evaluations),
        "diverged": sum(evaluation.diverged for evaluation in evaluations),
        "diverged_starts": sum(evaluation.diverged_starts for evaluation in evaluations),
    }
    figures |= latency(shipped)
    figures |= _batch_figures(shipped, min(BATCH_REPEATS, budget.repeats))
    return TableRow(figures, evaluations)


def _evaluations(emulators: list[Emulator], budget: EvaluationBudget) -> list[Evaluation]:
    """Return an evaluation per round, of the emulators in turn; diverged rollouts are counted in the first alone."""
    examples = few_transitions(emulators[0])
    without_rollouts = replace(budget, starts=0)
    evaluations = []
    for seed in range(max(budget.rounds, len(emulators))):
        emulator = emulators[seed % len(emulators)]
        chosen = without_rollouts if seed else budget
        evaluations.append(evaluate(emulator, data=examples, budget=chosen, seed=seed))
    return evaluations


def _medians(evaluations: list[Evaluation]) -> dict[str, Any]:
    """Return the medians of what every evaluation's row says."""
    rows = [evaluation.row() for evaluation in evaluations]
    return {key: _median_or_text([row[key] for row in rows]) for key in rows[0]}


def _median_or_text(values: list[Any]) -> Any:
    """Return the median of numbers, and the first text where there is one."""
    texts = [value for value in values if not isinstance(value, float)]
    return texts[0] if texts else float(np.median(values))


def _accuracy_figures(
    shipped: Emulator, evaluations: list[Evaluation], budget: EvaluationBudget
) -> dict[str, Any]:
    """Return quartiles, errors after a while and under shifted controls, and those of cheap predictors."""
    first = evaluations[0]
    nominal = [evaluation.speed.nominal for evaluation in evaluations]
    one_step = [evaluation.one_step_error for evaluation in evaluations]
    after_5s = [evaluation.rollout_error_at(5.0) for evaluation in evaluations]
    figures: dict[str, Any] = {
        "nominal_quartiles": quartiles(nominal),
        "nominal_plain_c": nominal_against_plain_c(shipped, budget.repeats),
        "nominal_1998": NOMINAL_1998.get((first.system, first.substeps), ""),
        "one_step_quartiles": quartiles(one_step),
        "one_step_error_shifted": shifted_error(shipped, budget),
        "rollout_error_5s": float(np.median(after_5s)),
        "self_divergence_1s": divergence_at(first, 1.0),
        "self_divergence_5s": divergence_at(first, 5.0),
    }
    for name, error in first.baselines.items():
        figures[f"{name.replace(' ', '_')}_error"] = error
    return figures


def nominal_against_plain_c(emulator: Emulator, repeats: int) -> float | str:
    """Return the nominal speed-up of a deformable body against its physics in plain C, both timed in turn on one core.

    Empty for rigid bodies, and where plain C knows neither the integrator nor the body.
    """
    system = system_of(emulator)
    if not isinstance(system, DeformableSystem) or system.scheme.integrator != "symplectic":
        return ""
    starts, controls = random_bodies(system, PIECES)
    steps = PHYSICS_STEPS // PIECES
    play = plain_player(system.body, starts, controls, system.physics_dt, steps)
    if play is None:
        return ""
    with one_core():
        players = emulator_players(emulator)
        spans = interleaved(players | {PLAIN_C: play}, repeats)
    per_super_step = min(spans[name] for name in players) / TIMED_SUPER_STEPS
    return spans[PLAIN_C] / PHYSICS_STEPS * emulator.substeps / per_super_step


def _batch_figures(shipped: Emulator, repeats: int) -> dict[str, Any]:
    """Return the time of a super step and of a physics step in batches."""
    program = program_of(shipped)
    figures: dict[str, Any] = {}
    for batch in BATCHES:
        figures[f"us_in_batch_{batch}"] = batch_microseconds(
            shipped, program, batch, repeats=repeats
        )
    for batch in BATCHES:
        figures[f"physics_us_in_batch_{batch}"] = physics_batch_microseconds(shipped, batch)
    return figures


def few_transitions(emulator: Emulator) -> Transitions:
    """Return enough transitions of the emulator's system to fit cheap predictors to."""
    spec = emulator.spec
    config = DatasetConfig(
        system=spec.system,
        definition=spec.definition,
        substeps=spec.substeps,
        count=BASELINE_EXAMPLES,
        samples_per_run=BASELINE_SAMPLES,
    )
    return simulate_transitions(config)


def shifted_error(emulator: Emulator, budget: EvaluationBudget) -> float:
    """Return the one-step error under controls training hardly saw: full range, another at every super step."""
    seconds = RUN_STEPS * emulator.dt
    usual = held_out_runs(emulator, count=budget.runs, seconds=seconds)
    system = usual.system
    shares = np.random.default_rng(0).uniform(-1, 1, usual.controls.shape)
    controls = system.bounds.middle + shares * system.bounds.half
    runs = system.simulate(usual.states[:, 0], controls, emulator.dt, scheme=system.fine)
    is_whole = ~runs.has_diverged
    test = make_test(system, emulator.dt, runs.states[is_whole], controls[is_whole])
    return float(root_mean_square(one_step_error(emulator, test)))


def divergence_at(evaluation: Evaluation, seconds: float) -> float:
    """Return how far the physics at its own step has strayed from fine physics after `seconds` [s]."""
    assert evaluation.self_divergence is not None
    last = len(evaluation.self_divergence) - 1
    step = round(seconds / evaluation.dt)
    return float(evaluation.self_divergence[min(step, last)])


def break_even_hours(emulator: Emulator, evaluation: Evaluation, chunk_seconds: float) -> float:
    """Return after how much simulated time [h] the emulator has saved what its data and training cost.

    Both are estimated from this machine's own speed: physics steps of the teacher, and a timed chunk of training.
    """
    recipe = RECIPES[evaluation.system]
    speed = evaluation.speed
    system = system_of(emulator)
    stride = recipe.stride(evaluation.substeps)
    runs = recipe.data(evaluation.system, stride).runs
    teacher = next(timed for timed in speed.opponents if timed.scheme == system.truth)
    per_step = teacher.seconds / system.truth.steps(emulator.dt)
    teacher_steps = system.truth.steps(stride * system.physics_dt)
    data_seconds = runs * RUN_STEPS * teacher_steps * per_step
    updates = recipe.training(stride).updates
    training_seconds = chunk_seconds * updates / UPDATES_PER_CHUNK
    saved = (speed.physics_seconds * evaluation.substeps - speed.emulator_seconds) / emulator.dt
    return (data_seconds + training_seconds) / saved / 3600


def latency(emulator: Emulator) -> dict[str, float]:
    """Return the 50th and 99th percentile of one super step called from Python [µs]: mostly the call."""
    step = emulator.step
    state = emulator.rest
    control = np.zeros(emulator.control.size)
    spans = []
    with one_core():
        step(state, control)  # compiles
        for _ in range(CALLS):
            began = time.perf_counter()
            step(state, control)
            spans.append((time.perf_counter() - began) * 1e6)
    return {
        "call_p50_us": float(np.percentile(spans, 50)),
        "call_p99_us": float(np.percentile(spans, 99)),
    }


def batch_microseconds(
    emulator: Emulator,
    program: CEmulator | None,
    batch: int,
    steps: int = BATCH_SUPER_STEPS,
    repeats: int = BATCH_REPEATS,
) -> float:
    """Return the time per trajectory and super step [µs] of a batch on one core: side by side, in JAX or in C.

    The faster counts; `program` is the emulator in C, if there is one.
    """
    run = compiled(emulator, jax.vmap(rollout, (None, 0, 0)))
    states = jnp.tile(jnp.asarray(emulator.rest), (batch, 1))
    middle = jnp.asarray(emulator.bounds.middle, jnp.float32)
    controls = jnp.tile(middle, (batch, steps, 1))
    run(states, controls).block_until_ready()
    players: dict[str, Callable[[], Any]] = {
        IN_JAX: lambda: run(states, controls).block_until_ready()
    }
    if program is not None:
        starts = np.asarray(states, np.float32)
        held = np.asarray(controls)
        program.rollouts(starts, held)
        players[IN_C] = partial(program.rollouts, starts, held)
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
