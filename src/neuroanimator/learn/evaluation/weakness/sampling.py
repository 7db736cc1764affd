"""Short runs for active learning: drawn from distributions of motions, simulated where large errors are expected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import step
from neuroanimator.learn.data.sampling import runs_near
from neuroanimator.learn.evaluation.accuracy import step_errors
from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.learn.evaluation.weakness.config import RUN_LENGTH, ImprovementConfig
from neuroanimator.state.arrays import as_rows
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System

MAX_SPEED_UP = 2.0
"""Largest factor on the velocities of a shifted start."""

FASTER_SHARE = 0.5
"""Share of the shifted starts whose velocities are scaled up."""

CONTROL_NOISE = 0.05
"""Standard deviation of the noise on controls near a motion, as a share of half their range."""

PROBE_SHARE = 0.25
"""Share of a round's runs drawn at random: errors are measured on them, and they keep the whole broad."""

POOL = 8
"""Number of candidate runs drawn and emulated for each simulated run."""

LEAST = 1e-6
"""Smallest score and error in logarithms: lower ones count as this."""

MAX_SLOPE = 2.0
"""Largest power of the score with which errors are expected to grow; the smallest is 0."""

MAX_SCORE = 1e6
"""Score that stands for larger ones, and for NaN."""

Drawn = tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N T C"]]
"""Starts (N, S) and the controls (N, T, C) from them."""


class RunBatch(NamedTuple):
    """Runs of T super steps, by the physics or yet to be simulated."""

    states: Float[np.ndarray, "N _ S"]
    """States (N, T+1, S); the starts alone, (N, 1, S), for runs yet to be simulated."""
    controls: Float[np.ndarray, "N T C"]
    source: Int[np.ndarray, " N"]
    """Number of the distribution each was drawn from; for windows, of the run each was cut from."""

    def rows(self, rows: Int[np.ndarray, " M"] | Bool[np.ndarray, " N"]) -> RunBatch:
        """Return those at `rows`."""
        return RunBatch(self.states[rows], self.controls[rows], self.source[rows])

    def shortened(self) -> RunBatch:
        """Return them in float32, as datasets and files hold them."""
        states = self.states.astype(np.float32)
        controls = self.controls.astype(np.float32)
        return RunBatch(states, controls, self.source.astype(np.int32))


class Distribution(NamedTuple):
    """A distribution of starts and controls for which an emulator should be accurate."""

    name: str
    draw: Callable[[np.random.Generator, np.ndarray, int], Drawn]
    """Function of a generator, of states (K, S) of the physics, and of the number of runs."""


def distributions_of(system: System, dt: float) -> list[Distribution]:
    """Return usual motions, and those beyond them."""
    return [
        Distribution("usual", partial(draw_usual, system, dt)),
        Distribution("shifted", partial(draw_shifted, system, dt)),
    ]


def draw_usual(
    system: System, dt: float, rng: np.random.Generator, known: Float[np.ndarray, "K S"], count: int
) -> Drawn:
    """Return starts and controls drawn as for datasets, from `known` states."""
    starts = known[rng.integers(0, len(known), count)]
    return starts, sample_control_runs(rng, count, RUN_LENGTH, dt, system)


def draw_shifted(
    system: System, dt: float, rng: np.random.Generator, known: Float[np.ndarray, "K S"], count: int
) -> Drawn:
    """Return starts and controls beyond what datasets show: faster, and with controls at their bounds, jumping or held."""
    starts = known[rng.integers(0, len(known), count)]
    speed_up = rng.uniform(1, MAX_SPEED_UP, count)
    speed_up[rng.random(count) >= FASTER_SHARE] = 1
    starts[:, rate_entries(system)] *= speed_up[:, None]
    usual = sample_control_runs(rng, count, RUN_LENGTH, dt, system)
    signs = rng.choice([-1, 1], usual.shape)
    jumping = system.bounds.middle + signs * system.bounds.half
    held = np.repeat(jumping[:, :1], RUN_LENGTH, axis=1)
    pattern = rng.integers(0, 3, count)[:, None, None]
    return starts, np.choose(pattern, [usual, jumping, held])


def draw_near(
    system: System,
    states: Float[np.ndarray, "F S"],
    controls: Float[np.ndarray, "M C"],
    rng: np.random.Generator,
    known: Float[np.ndarray, "K S"],
    count: int,
) -> Drawn:
    """Return starts and controls scattered around a motion: states (M+1, S) under controls (M, C)."""
    steps = rng.integers(0, len(controls), count)
    return runs_near(system, states, controls, steps, RUN_LENGTH, CONTROL_NOISE, rng)


def rate_entries(system: System) -> list[int]:
    """Return the state entries that are velocities."""
    return [entry for entry, name in enumerate(system.state.names) if name.endswith("/s")]


def draw_runs(
    distributions: Sequence[Distribution],
    rng: np.random.Generator,
    known: Float[np.ndarray, "K S"],
    count: int,
) -> RunBatch:
    """Return about `count` runs yet to be simulated, as many from each distribution."""
    of_each = -(-count // len(distributions))
    drawn = [distribution.draw(rng, known, of_each) for distribution in distributions]
    starts = np.concatenate([starts for starts, _ in drawn])
    controls = np.concatenate([controls for _, controls in drawn])
    return RunBatch(starts[:, None], controls, np.repeat(np.arange(len(distributions)), of_each))


def simulate_runs(
    system: System, runs: RunBatch, dt: float
) -> tuple[RunBatch, Bool[np.ndarray, " N"]]:
    """Return (the `runs` that do not diverge, by the physics; whether each is among them)."""
    simulated = system.simulate(runs.states[:, 0], runs.controls, dt, threads=core_count())
    is_sound = ~simulated.has_diverged
    return runs._replace(states=simulated.states).rows(is_sound), is_sound


def join_runs(parts: Sequence[RunBatch]) -> RunBatch:
    """Return all runs of `parts`, in their order."""
    return RunBatch(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def sample_weak_runs(
    emulator: Emulator,
    distributions: Sequence[Distribution],
    usual: HeldOut,
    known: Float[np.ndarray, "K S"],
    rng: np.random.Generator,
    config: ImprovementConfig,
) -> RunBatch:
    """Return a round's runs by the physics: a probe of all distributions, and runs in which large errors are expected."""
    system = usual.system
    probes = round(PROBE_SHARE * config.runs)
    pool = draw_runs(distributions, rng, known, POOL * config.runs)
    scores = _trust(emulator, pool)
    order = rng.permutation(len(scores))
    first, others = order[:probes], order[probes:]
    probe, is_sound = simulate_runs(system, pool.rows(first), emulator.dt)
    expected = expected_errors(
        scores[first][is_sound],
        errors_on(emulator, replace(usual, states=probe.states, controls=probe.controls)),
        probe.source,
        scores[others],
        pool.source[others],
    )
    # In proportion: the worst ones alone would be alike.
    odds = expected / expected.sum()
    rows = np.sort(rng.choice(len(others), config.runs - probes, replace=False, p=odds))
    weak, _ = simulate_runs(system, pool.rows(others[rows]), emulator.dt)
    return join_runs([probe, weak])


def expected_errors(
    probe_scores: Float[np.ndarray, "M T"],
    probe_errors: Float[np.ndarray, "M T"],
    probe_source: Int[np.ndarray, " M"],
    scores: Float[np.ndarray, "N T"],
    source: Int[np.ndarray, " N"],
) -> Float[np.ndarray, " N"]:
    """Return the mean error to expect in runs with these `scores` of trust, which cost no physics.

    They are predicted by a least-squares fit to a probe: log error = a + b log score, with an `a` for each distribution;
    one missing from the probe has the mean `a`.
    """
    x = np.log(np.maximum(probe_scores, LEAST)).ravel()
    y = np.log(np.maximum(probe_errors, LEAST)).ravel()
    rows = np.repeat(probe_source, probe_scores.shape[1])
    count = int(max(probe_source.max(), source.max())) + 1
    x_mean = _means(x, rows, count)
    y_mean = _means(y, rows, count)
    apart = x - x_mean[rows]
    slope = np.clip((apart @ (y - y_mean[rows])) / max(apart @ apart, LEAST), 0, MAX_SLOPE)
    height = y_mean - slope * x_mean
    log_scores = np.clip(np.log(np.maximum(scores, LEAST)), x.min(), x.max())
    return np.exp(height[source][:, None] + slope * log_scores).mean(axis=1)


def _means(
    values: Float[np.ndarray, " M"], rows: Int[np.ndarray, " M"], count: int
) -> Float[np.ndarray, " P"]:
    """Return the mean of the values in each of `count` rows; that of all for an empty row."""
    sums = np.bincount(rows, values, count)
    numbers = np.bincount(rows, minlength=count)
    return np.where(numbers > 0, sums / np.maximum(numbers, 1), values.mean())


def errors_on(emulator: Emulator, test: HeldOut) -> Float[np.ndarray, "B T"]:
    """Return the one-step error of each super step of the test's runs, in standard deviations of the usual change."""
    count, steps, _ = test.controls.shape
    states = as_rows(test.states[:, :-1])
    controls = as_rows(test.controls)
    ends = as_rows(test.states[:, 1:])
    emulated = _steps(emulator, as_jax(states), as_jax(controls))
    differences = test.frame.difference(ends, np.asarray(emulated, float))
    return step_errors(test.relative(differences)).reshape(count, steps)


@eqx.filter_jit
def _steps(
    emulator: Emulator, states: Float[Array, "M S"], controls: Float[Array, "M C"]
) -> Float[Array, "M S"]:
    """Return the states one super step later; compiled once for all weights."""
    return jax.vmap(partial(step, emulator))(states, controls)


def _trust(emulator: Emulator, runs: RunBatch) -> Float[np.ndarray, "N T"]:
    """Return the score of each super step of `runs`, as they are emulated."""
    scores = _scores_along(emulator, as_jax(runs.states[:, 0]), as_jax(runs.controls))
    return np.clip(np.nan_to_num(np.asarray(scores, float), nan=MAX_SCORE), 0, MAX_SCORE)


@eqx.filter_jit
def _scores_along(
    emulator: Emulator, starts: Float[Array, "N S"], controls: Float[Array, "N T C"]
) -> Float[Array, "N T"]:
    """Return the scores along emulated runs; compiled once for all weights."""

    def along(start: Array, held: Array) -> Array:
        latent = emulator.encode(start)
        return jax.lax.scan(emulator.step_latent_trusted, latent, emulator.encode_control(held))[1]

    return jax.vmap(along)(starts, controls)
