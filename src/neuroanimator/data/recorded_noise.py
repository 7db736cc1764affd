"""The noise of a recording: differences from sample to sample that belong to no smooth motion.

The p-th difference of samples x is d_k = Σ_i (-1)^i C(p, i) x_{k+i}. Noise that is independent from sample to sample, of
standard deviation σ, is in it with the variance C(2p, p) σ²; a motion that is smooth at the sampling interval is in it
ever less, the higher p is. So σ is estimated order after order until a higher one changes nothing any more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

MIN_ORDER = 2
"""Differences of the first order hold all that moves at a constant rate."""

MAX_ORDER = 8
"""A motion that is still in differences of this order is not smooth at its sampling interval."""

SETTLED = 0.97
"""An estimate has settled if that of the next order is no smaller than this share of it."""

MIN_DIFFERENCES = 50
"""Number of differences that make an estimate: it is then right to about 15 %."""

MIN_ROWS_PER_COLUMN = 10
"""Minimum number of differences a regression needs for each of its coefficients."""

MEDIAN_OF_NORMAL = 0.6745
"""Median of the magnitude of a normally distributed number of standard deviation 1."""


def noise_of(
    states: Sequence[Float[np.ndarray, "_ S"]], controls: Sequence[Float[np.ndarray, "_ C"]]
) -> Float[np.ndarray, " S"]:
    """Return the standard deviation of the noise in each state entry of runs; angles go on instead of jumping.

    It is 0 where none can be told from the motion: where there is none, or where the motion is not smooth at the
    sampling interval. Medians are taken, so that the few differences across an impact do not count. Noise that a sensor
    smooths over several samples is not seen.
    """
    estimates = []
    for order in range(MIN_ORDER, MAX_ORDER + 1):
        differences = _differences(states, controls, order)
        if len(differences) >= MIN_DIFFERENCES:
            estimates.append(_deviations(differences, order))
    size = states[0].shape[1]
    return np.array([_settled([row[entry] for row in estimates]) for entry in range(size)])


def _settled(estimates: list[float]) -> float:
    """Return the first estimate that a higher order hardly changes; 0 if there is none."""
    for lower, higher in pairwise(estimates):
        if higher >= SETTLED * lower:
            return higher
    return 0.0


def _deviations(differences: Float[np.ndarray, "N S"], order: int) -> Float[np.ndarray, " S"]:
    """Return the standard deviation of the noise that differences of that order are made of."""
    medians = np.median(np.abs(differences), axis=0)
    return medians / MEDIAN_OF_NORMAL / math.sqrt(math.comb(2 * order, order))


def _differences(
    states: Sequence[Float[np.ndarray, "_ S"]],
    controls: Sequence[Float[np.ndarray, "_ C"]],
    order: int,
) -> Float[np.ndarray, "N S"]:
    """Return the differences of that order of all runs, without what controls do to them.

    A motion has a kink where a control changes. So only those differences are taken during which none does; where
    controls change all the time, what is linear in them is taken away.
    """
    every = []
    acting = []
    for samples, held in zip(states, controls, strict=True):
        if len(samples) <= order:
            continue
        every.append(np.diff(samples, n=order, axis=0))
        # Sample k+1 follows control k: so many controls act within a difference.
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
    """Return what is left of `differences` by the regression on `controls`; all of it where they are too few."""
    if len(controls) < MIN_ROWS_PER_COLUMN * controls.shape[1]:
        return differences
    coefficients, *_ = np.linalg.lstsq(controls, differences, rcond=None)
    return differences - controls @ coefficients
