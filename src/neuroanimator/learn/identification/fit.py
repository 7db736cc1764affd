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

from neuroanimator.errors import ArgumentError
from neuroanimator.learn.identification.least_squares import (
    Normal,
    bounded_step,
    normal_equations,
    robust_cost,
)
from neuroanimator.learn.identification.measurements import Measurements
from neuroanimator.learn.identification.predictions import Prediction, Predictor, Slopes
from neuroanimator.learn.identification.unknowns import Unknowns

MAX_ITERATIONS = 60
"""Default maximum number of Gauss-Newton steps in a fit."""

FIRST_DAMPING = 1e-3
LESS_DAMPING = 0.1
MORE_DAMPING = 8.0
MAX_DAMPING = 1e4
"""Damping of steps (Levenberg and Marquardt): its initial value, its factors after a step that helped and after one
that did not, and its maximum, at which a fit ends."""

ENOUGH = 0.02
"""Decrease of the cost that is not worth a step: that of a fifth of a standard deviation of one unknown."""

PATIENCE = 3
"""Number of consecutive steps that may do less than that."""

KEPT = 0.5
"""Minimum share of the predicted decrease of the cost with which dear slopes are kept for the next step."""

NOISE_ROUNDS = 3
"""Number of times that the noise is estimated again and the fit continued with it."""

FIRST_NOISE = 0.05
"""Initial noise of a fit, as a share of the spread of each measured number."""

LEAST_NOISE = 1e-5
"""Minimum noise, as such a share: rounding."""

MEDIAN_TO_DEVIATION = 1.4826
"""Ratio of a normal distribution's standard deviation to the median of its absolute values."""


Predict = Callable[[Float[np.ndarray, "W I"], Float[np.ndarray, " G"]], Prediction]
"""Function from starts and shared unknowns to the sensors' readings."""


SlopesAt = Callable[[Float[np.ndarray, "W I"], Float[np.ndarray, " G"]], Slopes]
"""Function from starts and shared unknowns to predictions with their derivatives."""


@dataclass(frozen=True)
class Guess:
    """Unknowns from which a fit begins."""

    values: Float[np.ndarray, " G"]
    starts: Float[np.ndarray, "W I"]
    noise: Float[np.ndarray, " S"]
    """Standard deviation of residuals."""
    iterations: int = 0
    """Number of steps that led to them."""


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


@dataclass
class Fitting:
    """A fit, on its way or at its end."""

    fit: Fit
    slopes: Slopes
    """Predictions with their derivatives, at the fit or near it."""
    are_current: bool = True
    """Whether the slopes are those at the fit."""
    damping: float = FIRST_DAMPING


class Fitter:
    """Fits the unknowns of measurements, by an emulator or by the physics."""

    def __init__(
        self,
        measurements: Measurements,
        predictor: Predictor,
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

    def taken_up(self, fit: Fit) -> Guess:
        """Return the initial guess from a `fit` of shorter windows: its values, and those of its starts that begin a window."""
        every = len(fit.starts) // len(self.measurements.controls)
        return Guess(fit.values, fit.starts[::every], fit.noise, fit.iterations)

    def first_guess(self) -> Guess:
        """Return the nominal values and the measured starts, with the initial noise."""
        starts = self.predictor.starts_at(self.measurements.guess[:, 0])
        return Guess(self.unknowns.nominal.copy(), starts, FIRST_NOISE * self.spread)

    def seen(self, guess: Guess, prediction: Prediction) -> Fit:
        """Return the `guess` with the residuals of its motions."""
        residuals = self._residuals(prediction)
        return Fit(guess.values, guess.starts, residuals, guess.noise, guess.iterations)

    def normal(self, fit: Fit, slopes: Slopes, damping: float = 0.0) -> Normal:
        """Return the damped normal equations at a fit."""
        return normal_equations(
            fit.residuals, fit.noise, slopes, fit.values, self.unknowns, damping
        )

    def fitted(
        self,
        guess: Guess,
        predict: Predict,
        slopes_at: SlopesAt | None = None,
        max_iterations: int = MAX_ITERATIONS,
    ) -> Fitting:
        """Return the fit of `predict`'s motions, starting from `guess`; the noise is estimated between rounds.

        Where predictions come without slopes, those of `slopes_at`, by default the emulator's, are kept for the following
        steps as long as these do what they predict.
        """
        slopes_at = slopes_at or self.predictor.slopes
        prediction = predict(guess.starts, guess.values)
        fit = self.seen(guess, prediction)
        slopes = prediction.slopes or slopes_at(guess.starts, guess.values)
        descent = Fitting(fit, slopes)
        last = guess.iterations + max_iterations
        for _ in range(NOISE_ROUNDS):
            descent.damping = min(descent.damping, FIRST_DAMPING)
            self._descend(descent, predict, slopes_at, last)
            noise = self._noise_of(descent.fit.residuals)
            if np.allclose(noise, descent.fit.noise, rtol=0.1):
                break
            descent.fit = replace(descent.fit, noise=noise)
        return descent

    def _descend(self, descent: Fitting, predict: Predict, slopes_at: SlopesAt, last: int) -> None:
        """Take damped Gauss-Newton steps with fixed noise, as long as they help, up to iteration `last`."""
        small_steps = 0
        while descent.fit.iterations < last and descent.damping <= MAX_DAMPING:
            fit = descent.fit
            cost = self._cost(fit)
            normal = self.normal(fit, descent.slopes, descent.damping)
            step = bounded_step(normal, fit.values, self.unknowns)
            if step.gain < ENOUGH or small_steps == PATIENCE:
                return
            starts = self.predictor.moved(fit.starts, step.starts)
            iterations = fit.iterations + 1
            moved = Guess(fit.values + step.values, starts, fit.noise, iterations)
            prediction = predict(moved.starts, moved.values)
            following = self.seen(moved, prediction)
            decrease = cost - self._cost(following)
            is_better = decrease > 0
            gain = decrease if is_better else step.gain
            small_steps = small_steps + 1 if gain < ENOUGH else 0
            descent.fit = following if is_better else replace(fit, iterations=iterations)
            if is_better:
                descent.are_current = prediction.slopes is not None
                descent.damping *= LESS_DAMPING
            if is_better and prediction.slopes is not None:
                descent.slopes = prediction.slopes
            elif not descent.are_current and decrease < KEPT * (step.gain + normal.starts_gain):
                descent.slopes = slopes_at(descent.fit.starts, descent.fit.values)
                descent.are_current = True
            elif not is_better:
                descent.damping *= MORE_DAMPING

    def _residuals(self, prediction: Prediction) -> Float[np.ndarray, "W F S"]:
        """Return measurements minus predictions: infinite where a prediction is not finite."""
        measured = self.measurements.measured
        shown = prediction.shown
        residuals = measured - np.where(np.isfinite(shown), shown, np.inf)
        return np.where(np.isnan(measured), np.nan, residuals)

    def _cost(self, fit: Fit) -> float:
        return robust_cost(fit.residuals, fit.noise, fit.values, self.unknowns)

    def _noise_of(self, residuals: Float[np.ndarray, "W F S"]) -> Float[np.ndarray, " S"]:
        """Return the standard deviation of the noise of each number, robust against outliers.

        Residuals are smaller than the noise, since the unknowns absorb part of it. Raises ArgumentError if no motion is finite.
        """
        noise = np.ones(residuals.shape[-1])
        seen = self.is_measured
        typical = np.nanmedian(np.abs(residuals[..., seen]), axis=(0, 1))
        numbers = int(np.isfinite(residuals).sum())
        if not numbers:
            raise ArgumentError(
                "recordings: the physics diverges from every initial state that was found. With this much noise, give longer "
                "windows (--window), or measure velocities, too."
            )
        fitted = len(residuals) * self.predictor.start_size + len(self.unknowns.each)
        left = max(numbers - fitted, 1) / numbers
        deviation = MEDIAN_TO_DEVIATION * typical / np.sqrt(left)
        noise[seen] = np.maximum(deviation, LEAST_NOISE * self.spread[seen])
        return noise
