"""Error bounds of an emulator's rollouts: `emulator.error_bounds`, measured on runs that training never saw.

runs as in training, runs under controls found by descents → errors after each super step, trust scores along them
  → half of the runs: the power of the scores with which an error's logarithm grows (quantile regression)
  → the other half: the offset that brings the share `level` below it (split conformal prediction)
However good the regression is, this share of similar runs stays below. Kinds of motions are measured separately,
because optimisation leads to larger errors than scores suggest (Mondrian conformal prediction).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.error_bounds import LEVELS, ErrorBounds, errors_in, log_scores
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.data.store import Dataset
from neuroanimator.learn.training.optimised_controls import optimised_controls
from neuroanimator.learn.training.validation import usual_change
from neuroanimator.physics import carried_system
from neuroanimator.state.slowness import slowness
from neuroanimator.state.structure import Structure
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System

SECONDS = 2.0
"""Time after the start up to which errors are bounded [s]; longer for a slow system."""

RANDOM_RUNS = 2048
"""Number of runs simulated as in training: shares of 90 % are then accurate to 1 %."""

OPTIMISED_RUNS = 1024
"""Number of descents for controls."""

MIN_RUNS = 100
"""Minimum number of runs of a kind in measurements of the share that stays below."""

BOUNDS_SEED = 2**31 + 1
"""Seed of the runs, above all seeds of datasets and tests."""

LEAST_ERROR = 1e-6
"""Minimum error, to which smaller ones, due to rounding, are clipped."""

MOST_ERROR = 1e6
"""Maximum error, which also stands for NaN: the rollout has diverged."""

STEEPEST = 10.0
"""Maximum power of the scores with which errors are expected to grow."""

ROUNDING = 1e-9
"""Relative difference of two losses that is none."""


class UnseenRuns(NamedTuple):
    """Runs of the true physics that training left out."""

    states: Float[np.ndarray, "B F S"]
    """States (B, T+1, S)."""
    controls: Float[np.ndarray, "B T C"]


def fit_error_bounds(
    emulator: Emulator,
    data: Dataset | None = None,
    *,
    random_runs: int = RANDOM_RUNS,
    optimised_runs: int = OPTIMISED_RUNS,
    seed: int = 0,
    more_optimised: Sequence[UnseenRuns] = (),
) -> Emulator:
    """Return the emulator with `error_bounds`: for files from before there were any, or for other uses.

    Its system is simulated, which takes half a minute for shipped ones. An emulator of recordings has bounds for recorded
    motions only, from the runs that `data` kept apart. `more_optimised` are further runs under controls found through this
    emulator; each of them counts as much as the descents to random states made here.

    Raises ArgumentError if there are too few runs.
    """
    system = carried_system(emulator.system, emulator.spec.definition)
    if not system.can_simulate:
        if data is None or data.held_out is None:
            raise ArgumentError(
                f"data: {system.name} was learnt from recordings; pass the dataset that keeps some of them apart."
            )
        return with_error_bounds(emulator, system.structure, UnseenRuns(*data.held_out))
    random = simulate_random(emulator, system, random_runs, seed)
    optimised = list(more_optimised)
    if optimised_runs:
        optimised.insert(0, simulate_optimised(emulator, system, optimised_runs, seed))
    return with_error_bounds(emulator, system.structure, random, optimised)


def simulate_random(
    emulator: Emulator, system: System, count: int, seed: int, kind: int = 0
) -> UnseenRuns:
    """Return `count` runs as in training, without those that diverge; another `kind` draws others from the same seed."""
    rng = np.random.default_rng([BOUNDS_SEED, seed, kind])
    starts = sample_starts(system, rng, count, core_count())
    controls = sample_control_runs(rng, count, steps_of(emulator), emulator.dt, system)
    return simulate_unseen(emulator, system, starts, controls)


def simulate_optimised(emulator: Emulator, system: System, count: int, seed: int) -> UnseenRuns:
    """Return `count` runs under controls found by descents through the emulator, without those that diverge."""
    reachable = simulate_random(emulator, system, count, seed, kind=1)
    starts = reachable.states[:, 0]
    controls = optimised_controls(
        emulator, starts, reachable.states[:, -1], steps_of(emulator), seed
    )
    return simulate_unseen(emulator, system, starts, controls)


def simulate_unseen(
    emulator: Emulator,
    system: System,
    starts: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
) -> UnseenRuns:
    """Return the runs of the physics from starts under controls, without those that diverge."""
    runs = system.simulate_fastest(starts, controls, emulator.dt)
    return UnseenRuns(runs.states[~runs.has_diverged], controls[~runs.has_diverged])


def steps_of(emulator: Emulator) -> int:
    """Return the maximum number of super steps after which errors are bounded."""
    return max(1, round(SECONDS * slowness(emulator.dt) / emulator.dt))


def with_error_bounds(
    emulator: Emulator,
    structure: Structure,
    random: UnseenRuns,
    optimised: Sequence[UnseenRuns] = (),
) -> Emulator:
    """Return the emulator with bounds measured on runs of its physics, whose states have this `structure`.

    All of `optimised` count alike, whatever their numbers of runs.

    Raises ArgumentError if there are too few runs.
    """
    unit = usual_change(structure, random.states)
    measured = [_measured(emulator, structure, unit, runs) for runs in (random, *optimised)]
    centre = measured[0].size.mean(axis=0)
    kinds = [measured[:1]]
    if optimised:
        kinds.append(measured[1:])
    weights = [_weights_of(kind, centre) for kind in kinds]
    calibration = ErrorBounds(
        unit=unit.astype(np.float32),
        weights=np.stack(weights).astype(np.float32),
        centre=centre.astype(np.float32),
    )
    return replace(emulator, calibration=calibration)


class _Measured(NamedTuple):
    """Errors and trust scores of rollouts along some runs."""

    error: Float[np.ndarray, "B T"]
    """Logarithm of the error after each super step."""
    size: Float[np.ndarray, "B T"]
    """Logarithm of the root mean square of the scores up to that super step."""


def _measured(
    emulator: Emulator, structure: Structure, unit: Float[np.ndarray, " V"], runs: UnseenRuns
) -> _Measured:
    if len(runs.states) < MIN_RUNS:
        raise ArgumentError(
            f"runs: wanted at least {MIN_RUNS} of each kind to bound errors, got {len(runs.states)}."
        )
    emulated, scores = emulator.rollout_trusted(runs.states[:, 0], runs.controls, may_diverge=True)
    with np.errstate(all="ignore"):  # a rollout may diverge
        errors = errors_in(unit, structure, runs.states, emulated)[:, 1:]
    bounded = np.clip(np.nan_to_num(errors, nan=MOST_ERROR), LEAST_ERROR, MOST_ERROR)
    return _Measured(np.log(bounded), log_scores(np.asarray(scores, float)))


def _weights_of(
    groups: Sequence[_Measured], centre: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "L T 2"]:
    """Return (a, b) of the bounds' formula for each level and number of super steps."""
    error = np.concatenate([group.error for group in groups])
    size = np.concatenate([group.size for group in groups]) - centre
    share = np.concatenate([np.full(len(group.error), 1 / len(group.error)) for group in groups])
    share *= len(share) / share.sum()
    order = np.random.default_rng(BOUNDS_SEED).permutation(len(error))
    fitting, raising = np.array_split(order, 2)
    weights = np.empty((len(LEVELS), error.shape[1], 2))
    for number, level in enumerate(LEVELS):
        for step in range(error.shape[1]):
            line = quantile_line(size[fitting, step], error[fitting, step], share[fitting], level)
            left = error[raising, step] - line[0] - line[1] * size[raising, step]
            line[0] += conformal_quantile(left, share[raising], level)
            weights[number, step] = line
    return weights


def conformal_quantile(
    values: Float[np.ndarray, " N"], share: Float[np.ndarray, " N"], level: float
) -> float:
    """Return the bound below which a further value like these (N,) stays with probability at least `level`.

    Each counts by its `share`. It is the ⌈level (N + 1)⌉-th smallest if all count alike (Papadopoulos et al., 2002).
    """
    wanted = min(level * (len(values) + 1) / len(values) - 1e-12, 1.0)
    return float(np.quantile(values, wanted, weights=share, method="inverted_cdf"))


def quantile_line(
    size: Float[np.ndarray, " N"],
    error: Float[np.ndarray, " N"],
    share: Float[np.ndarray, " N"],
    level: float,
) -> Float[np.ndarray, " 2"]:
    """Return (a, b), b at least 0, such that a share `level` of the errors lies below a + b size, at about any size.

    It is quantile regression (Koenker and Bassett, 1978): for every b the best a is a quantile, and the loss with it is convex.
    """

    def offset(slope: float) -> float:
        left = error - slope * size
        return float(np.quantile(left, level, weights=share, method="inverted_cdf"))

    def loss(slope: float) -> float:
        left = error - offset(slope) - slope * size
        return float(share @ np.maximum(level * left, (level - 1) * left))

    slope = float(minimize_scalar(loss, bounds=(0, STEEPEST), method="bounded").x)
    if loss(0.0) <= loss(slope) * (1 + ROUNDING):  # equal scores say nothing
        slope = 0.0
    return np.array([offset(slope), slope])
