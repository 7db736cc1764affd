"""What a tenth of the time by the physics is worth: the 95th percentile of errors, with and without, and with the best choice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.trust.bounds import errors_of
from neuroanimator import Emulator, UnseenRuns, hybrid_rollout, load_emulator
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.learn.evaluation.weakness.sampling import rate_entries
from neuroanimator.learn.training.error_fitting import simulate_unseen, steps_of
from neuroanimator.physics.hybrid import PHYSICS_STEPS
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System

SHARE = 0.1
"""Of the super steps are the physics'."""

PERCENTILE = 0.95

SEED = 11

SHIFTED_SHARES = (0.0, 0.1, 0.5)
"""Shares of runs that are shifted."""

RUNS = 96
"""Of each mixture."""

FASTER = (1.2, 2.0)
"""Factors by which shifted starts move faster: see `trust.py`."""

BISECTIONS = 6
"""Thresholds tried until the physics has its share."""


def measure(name: str) -> list[dict[str, Any]]:
    """Return the rows of an emulator."""
    emulator = load_emulator(name)
    system = system_of(emulator)
    rows = []
    for shifted_share in SHIFTED_SHARES:
        runs = mixture(emulator, system, shifted_share)
        rows.append({"emulator": name, "shifted": shifted_share} | row_of(emulator, system, runs))
    return rows


def mixture(emulator: Emulator, system: System, shifted_share: float) -> UnseenRuns:
    """Return runs as in training, a share of them under controls at their bounds that jump, and from starts as fast again."""
    rng = np.random.default_rng([SEED, round(100 * shifted_share)])
    steps = steps_of(emulator)
    starts = sample_starts(system, rng, RUNS)
    controls = sample_control_runs(rng, RUNS, steps, emulator.dt, system)
    bounds = system.bounds
    for row in range(round(shifted_share * RUNS)):
        if row % 2:
            signs = rng.choice([-1, 1], controls[row].shape)
            controls[row] = bounds.middle + signs * bounds.half
        else:
            starts[row, rate_entries(system)] *= rng.uniform(*FASTER)
    return simulate_unseen(emulator, system, starts, controls)


def row_of(emulator: Emulator, system: System, runs: UnseenRuns) -> dict[str, Any]:
    """Return what a tenth of the time by the physics is worth on these runs: in single super steps, and in rollouts."""
    return one_step(emulator, system, runs) | rollouts(emulator, system, runs)


def one_step(emulator: Emulator, system: System, runs: UnseenRuns) -> dict[str, Any]:
    """Each super step from the physics' own state: those of the highest scores are made by the physics, without an error."""
    states = runs.states[:, :-1].reshape(-1, runs.states.shape[-1])
    controls = runs.controls.reshape(-1, runs.controls.shape[-1])
    ends = runs.states[:, 1:].reshape(-1, runs.states.shape[-1])
    pairs = UnseenRuns(np.stack([states, ends], axis=1), controls[:, None])
    errors = errors_of(emulator, system, pairs)[:, 0]
    scores = emulator.trust(states, controls)
    alone = np.quantile(errors, PERCENTILE)
    found = {}
    for chooser, by in (("hybrid", scores), ("best", errors)):
        left = np.where(by >= np.quantile(by, 1 - SHARE), 0.0, errors)
        found[chooser] = alone / np.quantile(left, PERCENTILE)
    return {
        "step_error_95": float(alone),
        "step_cut": float(found["hybrid"]),
        "step_cut_at_best": float(found["best"]),
    }


def rollouts(emulator: Emulator, system: System, runs: UnseenRuns) -> dict[str, Any]:
    """Whole rollouts; the threshold is the one with which the physics makes its share of the super steps."""
    row: dict[str, Any] = {}
    alone = np.quantile(errors_of(emulator, system, runs)[:, -1], PERCENTILE)
    row["rollout_error_95"] = float(alone)
    for stay in (1, PHYSICS_STEPS):

        def play(threshold: float, stay: int = stay) -> tuple[float, float]:
            return hybrid(emulator, system, runs, threshold, stay)

        threshold, share, error = at_share(play)
        row |= {
            f"threshold_{stay}": threshold,
            f"physics_share_{stay}": share,
            f"rollout_cut_{stay}": float(alone / error),
        }
    row["rollout_cut_first"] = float(alone / first_by_physics(emulator, system, runs))
    return row


def hybrid(
    emulator: Emulator, system: System, runs: UnseenRuns, threshold: float, stay: int
) -> tuple[float, float]:
    """Return (the physics' share, the 95th percentile of the error at the end) of hybrid rollouts."""
    ends = []
    shares = []
    for states, controls in zip(*runs, strict=True):
        motion = hybrid_rollout(
            emulator, system, states[0], controls, threshold=threshold, physics_steps=stay
        )
        ends.append(motion.states[-1])
        shares.append(motion.physics_share)
    return float(np.mean(shares)), _error_at_end(emulator, system, runs, np.array(ends))


def first_by_physics(emulator: Emulator, system: System, runs: UnseenRuns) -> float:
    """Return the 95th percentile where the first tenth of each run is the physics': what its share is worth anywhere."""
    first = round(SHARE * runs.controls.shape[1])
    later = UnseenRuns(runs.states[:, first:], runs.controls[:, first:])
    return float(np.quantile(errors_of(emulator, system, later)[:, -1], PERCENTILE))


def _error_at_end(emulator: Emulator, system: System, runs: UnseenRuns, ends: np.ndarray) -> float:
    assert emulator.calibration is not None
    errors = emulator.calibration.errors(system.structure, runs.states[:, -1], ends)
    return float(np.quantile(errors, PERCENTILE))


def at_share(play: Callable[[float], tuple[float, float]]) -> tuple[float, float, float]:
    """Return (threshold, share, error) where the physics' share is nearest to what it shall have."""
    low, high = -3.0, 2.0
    best = (0.0, 1.0, 0.0)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        threshold = float(10**middle)
        share, error = play(threshold)
        if abs(share - SHARE) < abs(best[1] - SHARE):
            best = (threshold, share, error)
        if share > SHARE:
            low = middle
        else:
            high = middle
    return best
