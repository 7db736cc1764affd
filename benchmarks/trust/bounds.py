"""Whether bounds of errors keep what they promise: the share of new motions below the bound of 90 %, by kind and horizon."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.trust.task_motions import task_motions
from neuroanimator import Emulator, UnseenRuns, load_emulator
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.learn.training.error_fitting import (
    conformal_quantile,
    simulate_optimised,
    simulate_random,
)
from neuroanimator.systems.system import System

LEVEL = 0.9

SECONDS = (0.5, 1.0, 2.0)
"""Horizons [s]."""

TEST_SEED = 7301
"""Bounds that ship were measured with seed 0, and looked at with seed 1 while they were made."""

RANDOM_RUNS = 1536
OPTIMISED_RUNS = 768

TRIALS = 24
"""Of each task of rigid bodies; those of swimmers, which take hundredths of a second, are four times as many."""

FIRST_TRIAL = 20_000
"""Bounds that ship were measured on trials below 1000, and looked at on some from there on while they were made."""


MEASURED_AGAIN = ("lander-25", "lander-100", "lander-50-large")
"""Bounds of these were measured again after a look at those motions: they are judged by the next seed, and trials further on."""


def test_of(name: str) -> tuple[int, int]:
    """Return (the seed of an emulator's new motions, the first of its trials)."""
    if name in MEASURED_AGAIN:
        return TEST_SEED + 1, 2 * FIRST_TRIAL
    return TEST_SEED, FIRST_TRIAL


def measure(name: str) -> list[dict[str, Any]]:
    """Return the rows of an emulator."""
    emulator = load_emulator(name)
    system = system_of(emulator)
    assert emulator.calibration is not None
    seed, first = test_of(name)
    kinds = {
        "as in training": simulate_random(emulator, system, RANDOM_RUNS, seed),
        "by descents": simulate_optimised(emulator, system, OPTIMISED_RUNS, seed),
    }
    trials = TRIALS if emulator.encoding.is_identity else 4 * TRIALS
    tasks = task_motions(emulator, system, range(first, first + trials))
    if tasks is not None:
        kinds["of tasks"] = tasks
    errors = {kind: errors_of(emulator, system, runs) for kind, runs in kinds.items()}
    # Rivals are measured on every other run, and judged on those between.
    plain = _plain_bound([errors["as in training"]])
    plain_apart = _plain_bound([errors[kind] for kind in kinds if kind != "as in training"])
    rows = []
    for kind, runs in kinds.items():
        is_random = kind == "as in training"
        arguments = (runs.states[:, 0], runs.controls)
        bounds = emulator.error_bounds(*arguments, level=LEVEL, are_optimised=not is_random)
        for seconds in SECONDS:
            step = round(seconds / emulator.dt) - 1
            error = errors[kind][:, step]
            bound = bounds[:, step]
            of_random = emulator.error_bounds(*arguments, level=LEVEL)[:, step]
            alone = plain[step] if is_random else plain_apart[step]
            rows.append(
                {
                    "emulator": name,
                    "motions": kind,
                    "seconds": seconds,
                    "runs": len(error),
                    "error_median": float(np.median(error)),
                    "error_90": float(np.quantile(error, LEVEL)),
                    "bound_median": float(np.median(bound)),
                    "covered": float(np.mean(error <= bound)),
                    "covered_low_scores": _share(error <= bound, _is_low(bound)),
                    "covered_high_scores": _share(error <= bound, ~_is_low(bound)),
                    "covered_scores_random_only": float(np.mean(error <= of_random)),
                    "covered_one_bound_random_only": float(np.mean(error[1::2] <= plain[step])),
                    "covered_one_bound_apart": float(np.mean(error[1::2] <= alone)),
                    "one_bound_over_median": float(alone / np.median(bound)),
                }
            )
    rows.extend(_controllers(rows))
    return rows


def _controllers(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return rows of both kinds of controllers' motions together, each counting as much: as bounds were measured."""
    together = []
    for seconds in SECONDS:
        some = [
            row for row in rows if row["seconds"] == seconds and row["motions"] != "as in training"
        ]
        mean = {
            key: float(np.mean([row[key] for row in some]))
            for key in some[0]
            if key.startswith(("covered", "error", "bound", "one")) and key != "emulator"
        }
        runs = sum(row["runs"] for row in some)
        named = {"emulator": some[0]["emulator"], "motions": "of controllers"}
        together.append({**named, "seconds": seconds, "runs": runs, **mean})
    return together


def _share(is_covered: np.ndarray, some: np.ndarray) -> float:
    """Return the share of `some` that is covered; NaN where there are none, as of one bound for all."""
    return float(is_covered[some].mean()) if some.any() else float("nan")


def _is_low(bound: np.ndarray) -> np.ndarray:
    """Return which motions have the lower half of the bounds, and so of the scores."""
    return bound <= np.median(bound)


def _plain_bound(kinds: list[np.ndarray]) -> np.ndarray:
    """Return one bound for all motions after each super step, each kind (B, T) counting as much, by every other run."""
    known = [errors[::2] for errors in kinds]
    every = np.concatenate(known)
    shares = np.concatenate([np.full(len(errors), 1 / len(errors)) for errors in known])
    columns = range(every.shape[1])
    return np.array([conformal_quantile(every[:, step], shares, LEVEL) for step in columns])


def errors_of(emulator: Emulator, system: System, runs: UnseenRuns) -> np.ndarray:
    """Return the error of the emulator (B, T) after each super step."""
    assert emulator.calibration is not None
    emulated = emulator.rollout(runs.states[:, 0], runs.controls, may_diverge=True)
    return emulator.calibration.errors(system.structure, runs.states, emulated)[:, 1:]
