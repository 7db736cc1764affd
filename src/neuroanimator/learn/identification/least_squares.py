"""Gauss-Newton steps for unknowns shared by all windows and starts of single windows.

The starts are eliminated window by window (Schur complement), so that a step costs no more than its predictions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from neuroanimator.learn.identification.predictions import Slopes
from neuroanimator.learn.identification.unknowns import Unknowns

HUBER = 2.5
"""Residual beyond which the cost is linear, in standard deviations (Huber, 1964)."""

PRIOR = 1e-4
"""Weight of staying at nominal values, where a whole range counts as a residual of one standard deviation: it keeps
unknowns that a recording does not show at their values."""

LEAST = 1e-12
"""Minimum diagonal entry of the starts' normal equations, relative to the largest."""

SLOPE_ERROR = 1e-4
"""Relative error of slopes, from finite differences of such a share of a range: it looks like information where there is
none."""


class Step(NamedTuple):
    """A change of all unknowns."""

    values: Float[np.ndarray, " G"]
    starts: Float[np.ndarray, "W V"]
    gain: float
    """Predicted decrease of the cost by the change of the shared unknowns, if motions are linear."""


class Normal(NamedTuple):
    """Normal equations with the starts eliminated."""

    matrix: Float[np.ndarray, "G G"]
    """Information on the shared unknowns, given that the starts are unknown, too."""
    right: Float[np.ndarray, " G"]
    starts_matrix: Float[np.ndarray, "W V V"]
    starts_right: Float[np.ndarray, "W V"]
    cross: Float[np.ndarray, "W V G"]
    starts_gain: float
    """Predicted decrease of the cost by the starts, if motions are linear."""

    def matrix_of_shares(self, unknowns: Unknowns) -> Float[np.ndarray, "G G"]:
        """Return the matrix for changes over the unknowns' ranges."""
        scale = unknowns.high - unknowns.low
        matrix = self.matrix * np.outer(scale, scale)
        return (matrix + matrix.T) / 2


def robust_weights(
    residuals: Float[np.ndarray, "W F S"], noise: Float[np.ndarray, " S"]
) -> Float[np.ndarray, "W F S"]:
    """Return the weight of each residual: one over the noise's variance, less for outliers, zero if not measured."""
    scaled = np.abs(residuals) / noise
    with np.errstate(invalid="ignore", divide="ignore"):
        weights = np.minimum(1.0, HUBER / scaled)
    return np.where(np.isnan(residuals), 0.0, np.where(scaled > 0, weights, 1.0) / noise**2)


def robust_cost(
    residuals: Float[np.ndarray, "W F S"],
    noise: Float[np.ndarray, " S"],
    values: Float[np.ndarray, " G"],
    unknowns: Unknowns,
) -> float:
    """Return Huber's cost of the residuals, half a square each within `HUBER` deviations, and of leaving nominal values.

    Infinite if a prediction of a measured number is not finite.
    """
    scaled = np.abs(residuals) / noise
    if np.isinf(scaled).any():
        return np.inf
    square = np.minimum(scaled, HUBER)
    costs = square * (scaled - square / 2)
    away = (values - unknowns.nominal) / (unknowns.high - unknowns.low)
    return float(np.nansum(costs) + PRIOR * np.sum(away**2) / 2)


def normal_equations(
    residuals: Float[np.ndarray, "W F S"],
    noise: Float[np.ndarray, " S"],
    slopes: Slopes,
    values: Float[np.ndarray, " G"],
    unknowns: Unknowns,
    damping: float = 0.0,
) -> Normal:
    """Return the damped normal equations at `values`; `residuals` are measurements minus predictions."""
    weights = robust_weights(residuals, noise)
    known = np.where(weights > 0, residuals, 0.0)
    count, _, _, shared = slopes.by_unknowns.shape
    by_values = slopes.by_unknowns.reshape(count, -1, shared)
    by_starts = slopes.by_starts.reshape(count, by_values.shape[1], -1)
    weight = weights.reshape(count, -1, 1)
    error = known.reshape(count, -1, 1)
    of_starts = np.swapaxes(by_starts, 1, 2)
    starts_matrix = of_starts @ (weight * by_starts)
    diagonal = np.einsum("wvv->wv", starts_matrix)
    diagonal += damping * diagonal + LEAST * float(diagonal.max(initial=1.0))
    cross = of_starts @ (weight * by_values)
    starts_right = (of_starts @ (weight * error))[..., 0]
    of_values = np.swapaxes(by_values, 1, 2)
    matrix = (of_values @ (weight * by_values)).sum(axis=0)
    right = (of_values @ (weight * error))[..., 0].sum(axis=0)
    prior = PRIOR / (unknowns.high - unknowns.low) ** 2
    matrix += np.diag(prior)
    right -= prior * (values - unknowns.nominal)
    matrix += damping * np.diag(np.diag(matrix))
    solved = np.linalg.solve(
        starts_matrix, np.concatenate([cross, starts_right[..., None]], axis=2)
    )
    crossed = np.swapaxes(cross, 1, 2) @ solved
    return Normal(
        matrix=matrix - crossed[..., :-1].sum(axis=0),
        right=right - crossed[..., -1].sum(axis=0),
        starts_matrix=starts_matrix,
        starts_right=starts_right,
        cross=cross,
        starts_gain=float(np.sum(starts_right * solved[..., -1]) / 2),
    )


def bounded_step(normal: Normal, values: Float[np.ndarray, " G"], unknowns: Unknowns) -> Step:
    """Return the step that solves the normal equations with all shared unknowns within their bounds."""
    scale = unknowns.high - unknowns.low
    matrix = normal.matrix_of_shares(unknowns)
    floor = LEAST * np.trace(matrix) + np.finfo(float).tiny
    lower = np.linalg.cholesky(matrix + floor * np.eye(len(matrix)))
    target = solve_triangular(lower, normal.right * scale, lower=True)
    low = (unknowns.low - values) / scale
    high = (unknowns.high - values) / scale
    share = lsq_linear(lower.T, target, (low, np.maximum(high, low + 1e-12))).x
    change = np.clip(share, low, high) * scale
    rest = normal.starts_right - normal.cross @ change
    starts = np.linalg.solve(normal.starts_matrix, rest[..., None])[..., 0]
    gain = float(normal.right @ change - change @ normal.matrix @ change / 2)
    return Step(change, starts, gain)


def covariance(normal: Normal, unknowns: Unknowns) -> Float[np.ndarray, "G G"]:
    """Return the covariance of the shared unknowns, from undamped normal equations with inverse variances as weights.

    Errors of slopes look like information, and as much of it does not count: a combination of which no more is known has
    the variance of the prior alone.
    """
    scale = unknowns.high - unknowns.low
    information, directions = np.linalg.eigh(normal.matrix_of_shares(unknowns))
    feigned = SLOPE_ERROR**2 * information[-1]
    variances = 1 / np.maximum(information - feigned, PRIOR)
    return (directions * variances) @ directions.T * np.outer(scale, scale)
