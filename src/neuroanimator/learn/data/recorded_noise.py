"""The noise of a recording: differences between samples that belong to no smooth motion.

The p-th difference of samples x is d_k = Σ_i (-1)^i C(p, i) x_{k+i}. Noise of standard deviation σ that is independent
between samples contributes the variance C(2p, p) σ² to it; a motion that is smooth at the sampling interval contributes
less and less as p grows. So σ is estimated with growing order until the estimate no longer changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

MIN_ORDER = 2
"""Lowest order of differences: those of first order contain any motion at a constant rate."""

MAX_ORDER = 8
"""Highest order of differences: a motion that still shows in them is not smooth at its sampling interval."""

SETTLED = 0.97
"""Minimum ratio of the next order's estimate to this one for the estimate to have settled."""

MIN_DIFFERENCES = 50
"""Minimum number of differences for an estimate, which is then accurate to about 15 %."""

MIN_ROWS_PER_COLUMN = 10
"""Minimum number of differences in a regression for each of its coefficients."""

MEDIAN_OF_NORMAL = 0.6745
"""Median of the magnitude of a normally distributed number of standard deviation 1."""


def noise_of(
    states: Sequence[Float[np.ndarray, "_ S"]], controls: Sequence[Float[np.ndarray, "_ C"]]
) -> Float[np.ndarray, " S"]:
    """Return the standard deviation of the noise in each state entry of runs, with angles unwrapped.

    It is 0 where noise cannot be told from motion: where there is none, or where the motion is not smooth at the
    sampling interval. Medians keep the few differences across an impact from counting. Noise that a sensor
    smooths over several samples is not detected.
    """
    estimates = []
    for order in range(MIN_ORDER, MAX_ORDER + 1):
        differences = _differences(states, controls, order)
        if len(differences) >= MIN_DIFFERENCES:
            estimates.append(_deviations(differences, order))
    size = states[0].shape[1]
    return np.array([_settled([row[entry] for row in estimates]) for entry in range(size)])


def _settled(estimates: list[float]) -> float:
    """Return the first estimate that the next order hardly changes; 0 if there is none."""
    for lower, higher in pairwise(estimates):
        if higher >= SETTLED * lower:
            return higher
    return 0.0


def _deviations(differences: Float[np.ndarray, "N S"], order: int) -> Float[np.ndarray, " S"]:
    """Return the standard deviation of the noise that differences of the given order contain."""
    medians = np.median(np.abs(differences), axis=0)
    return medians / MEDIAN_OF_NORMAL / math.sqrt(math.comb(2 * order, order))


def _differences(
    states: Sequence[Float[np.ndarray, "_ S"]],
    controls: Sequence[Float[np.ndarray, "_ C"]],
    order: int,
) -> Float[np.ndarray, "N S"]:
    """Return the differences of the given order of all runs, without the effect of the controls.

    A motion has a kink where a control changes, so only differences during which none changes are used; where
    controls change all the time, the part that is linear in them is removed.
    """
    every = []
    acting = []
    for samples, held in zip(states, controls, strict=True):
        if len(samples) <= order:
            continue
        every.append(np.diff(samples, n=order, axis=0))
        # Sample k+1 follows control k, so `order` controls act within a difference.
        acting.append(np.lib.stride_tricks.sliding_window_view(held[:-1], order, axis=0))
    if not every:
        return np.zeros((0, states[0].shape[1]))
    differences = np.concatenate(every)
    controls_within = np.concatenate(acting)
    is_held = (np.ptp(controls_within, axis=-1) == 0).all(axis=1)
    if is_held.sum() >= MIN_DIFFERENCES:
        return differences[is_held]
    return _without_linear_part(differences, controls_within.reshape(len(differences), -1))


def _without_linear_part(
    differences: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N P"]
) -> Float[np.ndarray, "N S"]:
    """Return the residuals of regressing `differences` on `controls`; `differences` unchanged if they are too few."""
    if len(controls) < MIN_ROWS_PER_COLUMN * controls.shape[1]:
        return differences
    coefficients, *_ = np.linalg.lstsq(controls, differences, rcond=None)
    return differences - controls @ coefficients
