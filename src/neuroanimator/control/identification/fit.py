"""The fit: Gauss-Newton through the emulator, then on the physics with the emulator's slopes.

    measurements → predictions (emulator) → residuals → robust weights → step of all unknowns → … → noise
      ⤷ predictions (physics) → residuals → the same step with the emulator's slopes → …

The second half is as for controllers: where physics and emulator disagree, the physics is right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from neuroanimator.control.identification.least_squares import (
    bounded_step,
    normal_equations,
    robust_cost,
    robust_weights,
)
from neuroanimator.control.identification.measurements import Measurements
from neuroanimator.control.identification.predictions import (
    MeasuredStartPredictor,
    Predictor,
    Slopes,
)
from neuroanimator.control.identification.unknowns import Unknowns

MAX_ITERATIONS = 40
"""Maximum number of Gauss-Newton steps in a fit."""

FIRST_DAMPING = 1e-3
LESS_DAMPING = 0.1
MORE_DAMPING = 8.0
MAX_DAMPING = 1e4
"""Damping of steps (Levenberg and Marquardt): its initial value, its factors after a step that helped and after one
that did not, and its maximum, at which a fit ends."""

TOLERANCE = 1e-4
"""Minimum relative decrease of the cost by a step that counts, or predicted decrease if it did not help."""

PATIENCE = 3
"""Number of consecutive steps that may do less: the first are damped, and slow where much is uncertain."""

NOISE_ROUNDS = 3
"""Number of times that the noise is estimated again and the fit continued with it."""

FIRST_NOISE = 0.05
"""Initial noise of a fit, as a share of the spread of each measured number."""

LEAST_NOISE = 1e-5
"""Minimum noise, as such a share: rounding."""

MEDIAN_TO_DEVIATION = 1.4826
"""Ratio of a normal distribution's standard deviation to the median of its absolute values."""

Predict = Callable[[Float[np.ndarray, "W I"], Float[np.ndarray, " G"]], Float[np.ndarray, "W F S"]]
"""Function from starts and shared unknowns to the sensors' readings."""


@dataclass(frozen=True)
class Fit:
    """Unknowns that explain the measurements best."""

    values: Float[np.ndarray, " G"]
    starts: Float[np.ndarray, "W I"]
    residuals: Float[np.ndarray, "W F S"]
    """Measurements minus predictions; NaN where nothing was measured."""
    noise: Float[np.ndarray, " S"]
    """Standard deviation of residuals; 1 for numbers that were not measured."""
    iterations: int


SlopesAt = Callable[[Fit], Slopes]
"""Function from a fit to predictions with their derivatives."""


class Fitter:
    """Fits the unknowns of measurements, by an emulator or by the physics."""

    def __init__(
        self,
        measurements: Measurements,
        predictor: Predictor | MeasuredStartPredictor,
        unknowns: Unknowns,
    ):
        self.measurements = measurements
        self.predictor = predictor
        self.unknowns = unknowns
        measured = measurements.measured
        seen = ~np.isnan(measured).all(axis=(0, 1))
        spread = np.ones(measured.shape[-1])
        spread[seen] = np.nanstd(measured[..., seen], axis=(0, 1))
        self.is_measured = seen
        self.spread = np.where(spread > 0, spread, 1.0)

    def taken_up(self, fit: Fit) -> Fit:
        """Return the initial guess from a `fit` of windows of half the length: its values, and every other of its starts."""
        starts = fit.starts[::2]
        residuals = self._residuals(self.predictor.by_emulator, starts, fit.values)
        return replace(fit, starts=starts, residuals=residuals)

    def first_guess(self) -> Fit:
        """Return the nominal values and the measured starts, with the initial noise."""
        starts = self.predictor.starts_at(self.measurements.guess[:, 0])
        values = self.unknowns.nominal.copy()
        residuals = self._residuals(self.predictor.by_emulator, starts, values)
        return Fit(values, starts, residuals, FIRST_NOISE * self.spread, 0)

    def fitted(self, guess: Fit, predict: Predict, slopes: SlopesAt | None = None) -> Fit:
        """Return the fit of `predict`'s motions, starting from `guess`; the noise is estimated between rounds.

        The `slopes` are the emulator's by default.
        """
        fit = guess
        for _ in range(NOISE_ROUNDS):
            fit = self._round(fit, predict, slopes or self.slopes)
            noise = self._noise_of(fit.residuals)
            if np.allclose(noise, fit.noise, rtol=0.1):
                break
            fit = replace(fit, noise=noise)
        return fit

    def slopes(self, fit: Fit) -> Slopes:
        """Return the emulator's predictions and their derivatives at a fit."""
        return self.predictor.slopes(fit.starts, fit.values)

    def _round(self, fit: Fit, predict: Predict, slopes_at: SlopesAt) -> Fit:
        """Return the fit with fixed noise: damped Gauss-Newton steps, as long as they help."""
        residuals = self._residuals(predict, fit.starts, fit.values)
        cost = self._cost(residuals, fit.noise, fit.values)
        fit = replace(fit, residuals=residuals)
        damping = FIRST_DAMPING
        slopes = slopes_at(fit)
        small_steps = 0
        for _ in range(MAX_ITERATIONS):
            weights = robust_weights(fit.residuals, fit.noise)
            normal = normal_equations(
                fit.residuals, weights, slopes, fit.values, self.unknowns, damping
            )
            step = bounded_step(normal, fit.values, self.unknowns)
            values = fit.values + step.values
            starts = self.predictor.moved(fit.starts, step.starts)
            residuals = self._residuals(predict, starts, values)
            following = self._cost(residuals, fit.noise, values)
            iterations = fit.iterations + 1
            is_better = following < cost
            gain = cost - following if is_better else step.gain
            is_small = gain < TOLERANCE * cost
            small_steps = small_steps + 1 if is_small else 0
            if is_better:
                fit = Fit(values, starts, residuals, fit.noise, iterations)
                cost = following
                damping *= LESS_DAMPING
                if small_steps < PATIENCE:
                    slopes = slopes_at(fit)
            else:
                fit = replace(fit, iterations=iterations)
                damping *= MORE_DAMPING
            if small_steps == PATIENCE or damping > MAX_DAMPING:
                break
        return fit

    def _residuals(
        self,
        predict: Predict,
        starts: Float[np.ndarray, "W I"],
        values: Float[np.ndarray, " G"],
    ) -> Float[np.ndarray, "W F S"]:
        """Return measurements minus predictions: infinite where a prediction is not finite."""
        measured = self.measurements.measured
        shown = predict(starts, values)
        residuals = measured - np.where(np.isfinite(shown), shown, np.inf)
        return np.where(np.isnan(measured), np.nan, residuals)

    def _cost(
        self,
        residuals: Float[np.ndarray, "W F S"],
        noise: Float[np.ndarray, " S"],
        values: Float[np.ndarray, " G"],
    ) -> float:
        return robust_cost(residuals, noise, values, self.unknowns)

    def _noise_of(self, residuals: Float[np.ndarray, "W F S"]) -> Float[np.ndarray, " S"]:
        """Return the standard deviation of the noise of each number, robust against outliers.

        Residuals are smaller than the noise, since the unknowns absorb part of it.
        """
        noise = np.ones(residuals.shape[-1])
        seen = self.is_measured
        typical = np.nanmedian(np.abs(residuals[..., seen]), axis=(0, 1))
        numbers = int(np.isfinite(residuals).sum())
        fitted = len(residuals) * self.predictor.start_size + self.unknowns.size
        left = max(numbers - fitted, 1) / numbers
        deviation = MEDIAN_TO_DEVIATION * typical / np.sqrt(left)
        noise[seen] = np.maximum(deviation, LEAST_NOISE * self.spread[seen])
        return noise
