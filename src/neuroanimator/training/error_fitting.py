"""Error bounds of an emulator's rollouts: `emulator.error_bounds`, measured on runs that training never saw.

runs as in training, runs under controls that descents found → errors after each super step, scores on the way
  → half of the runs: the power of the scores with which an error's logarithm grows (quantile regression)
  → the other half: by how much that must be raised until the share `level` stays below (split conformal prediction)
Whatever the regression is worth, of runs like the other half so many stay below. Kinds of motions are measured apart,
because optimisation leads where an emulator errs more than its scores say (Mondrian conformal prediction).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.data.store import Dataset
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.error_bounds import LEVELS, ErrorBounds, errors_in, log_scores
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.errors import ArgumentError
from neuroanimator.executor.cores import core_count
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.slowness import slowness
from neuroanimator.state.structure import Structure
from neuroanimator.systems import carried_system
from neuroanimator.systems.system import System
from neuroanimator.training.optimised_controls import optimised_controls

SECONDS = 2.0
"""Time after the start up to which errors are bounded [s]; of a slow system longer."""

RANDOM_RUNS = 2048
"""Number of runs simulated as in training: shares of 90 % are then right to 1 %."""

OPTIMISED_RUNS = 1024
"""Number of controls sought by descents."""

MIN_RUNS = 100
"""With fewer runs of a kind there are too few to measure by how many stay below."""

BOUNDS_SEED = 2**31 + 1
"""Runs are drawn from this seed, above all that datasets and tests are drawn from."""

LEAST_ERROR = 1e-6
"""Errors below it count as it: they are rounding."""

MOST_ERROR = 1e6
"""Errors above it, and those that are no numbers, count as it: the rollout has diverged."""

RIDGE = 1e-6
"""Added to the curvature of the regression, so that scores that are all alike do no harm."""

BANDWIDTHS = (0.5, 0.2, 0.1, 0.05)
"""Of the smoothed quantile loss, in logarithms of errors: from easy to exact."""

NEWTON_STEPS = 12
"""With each of these."""


class UnseenRuns(NamedTuple):
    """Runs of the true physics that training left out."""

    states: Float[np.ndarray, "B F S"]
    """(B, T+1, S)"""
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

    Its system is simulated for that: half a minute of what ships. Of one known from recordings alone there are bounds of
    recorded motions only, by the runs that `data` kept apart. `more_optimised` are further runs under controls that were
    found through this emulator; each of them counts as much as the descents to random states that are made here.

    Raises ArgumentError where there are too few runs.
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
    """Return `count` runs as in training, less those that diverge; `kind` draws others of the same seed."""
    rng = np.random.default_rng([BOUNDS_SEED, seed, kind])
    starts = sample_starts(system, rng, count, core_count())
    controls = sample_control_runs(rng, count, steps_of(emulator), emulator.dt, system)
    return simulate_unseen(emulator, system, starts, controls)


def simulate_optimised(emulator: Emulator, system: System, count: int, seed: int) -> UnseenRuns:
    """Return `count` runs under controls that descents through the emulator came to, less those that diverge."""
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
    """Return what the physics makes of starts and controls, less what diverges."""
    runs = system.simulate_fastest(starts, controls, emulator.dt)
    return UnseenRuns(runs.states[~runs.has_diverged], controls[~runs.has_diverged])


def steps_of(emulator: Emulator) -> int:
    """Return after how many super steps errors are bounded at most."""
    return max(1, round(SECONDS * slowness(emulator.dt) / emulator.dt))


def with_error_bounds(
    emulator: Emulator,
    structure: Structure,
    random: UnseenRuns,
    optimised: Sequence[UnseenRuns] = (),
) -> Emulator:
    """Return the emulator with bounds measured on runs of its physics, whose states have this `structure`.

    Of `optimised` each counts as much as any other, however many runs it has.

    Raises ArgumentError where there are too few runs.
    """
    unit = _usual_change(structure, random.states)
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


def _usual_change(
    structure: Structure, states: Float[np.ndarray, "B F S"]
) -> Float[np.ndarray, " V"]:
    """Return the standard deviation of each number's change in a super step; 0 for what never moves."""
    changes = Frame.of(structure, 0.0).difference(states[:, :-1], states[:, 1:])
    deviation = changes.std(axis=(0, 1))
    return structure.common_scale(np.where(deviation >= MIN_CHANGE, deviation, 0))


class _Measured(NamedTuple):
    """Errors and trust scores of rollouts along some runs."""

    error: Float[np.ndarray, "B T"]
    """Logarithm of the error after each super step."""
    size: Float[np.ndarray, "B T"]
    """Logarithm of the root mean square of the scores up to it."""


def _measured(
    emulator: Emulator, structure: Structure, unit: Float[np.ndarray, " V"], runs: UnseenRuns
) -> _Measured:
    if len(runs.states) < MIN_RUNS:
        raise ArgumentError(
            f"runs: wanted {MIN_RUNS} of a kind at least to bound errors by, came {len(runs.states)}."
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
    """Return what a further value stays below with probability `level` at least, where it is like these (N,).

    Each counts by its `share`. It is the ⌈level (N + 1)⌉-th smallest where all count alike (Papadopoulos et al., 2002).
    """
    order = np.argsort(values)
    reached = np.cumsum(share[order]) / share.sum()
    wanted = level * (len(values) + 1) / len(values)
    place = int(np.searchsorted(reached, wanted - 1e-12))
    return float(values[order][min(place, len(values) - 1)])


def quantile_line(
    size: Float[np.ndarray, " N"],
    error: Float[np.ndarray, " N"],
    share: Float[np.ndarray, " N"],
    level: float,
) -> Float[np.ndarray, " 2"]:
    """Return (a, b), b at least 0, such that a share `level` of the errors lies below a + b size, about wherever one looks.

    It is quantile regression (Koenker and Bassett, 1978), its loss smoothed by a logistic kernel and descended by Newton.
    """
    inputs = np.stack([np.ones_like(size), size], axis=1)
    line = np.array([np.quantile(error, level), 0.0])
    ridge = RIDGE * len(error) * np.eye(2)
    for bandwidth in BANDWIDTHS:
        for _ in range(NEWTON_STEPS):
            left = (error - inputs @ line) / bandwidth
            below = 0.5 * (1 - np.tanh(left / 2))
            slope = inputs.T @ (share * (below - level))
            bend = share * below * (1 - below) / bandwidth
            step = np.linalg.solve((inputs * bend[:, None]).T @ inputs + ridge, slope)
            # No further at a time than where the curvature still says anything.
            line = line - step / max(1.0, np.abs(inputs @ step).max())
    if line[1] < 0:
        return np.array([np.quantile(error, level), 0.0])
    return line
