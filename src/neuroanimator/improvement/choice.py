"""Which runs are simulated: those in which large errors are to be expected, in proportion, so that they stay broad.

What error is to be expected is read off the score of trust, which costs no physics, by a line fitted to what a small
probe has measured: log error = a_place + b log trust.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.improvement.places import Stretches

LEAST = 1e-6
"""Scores and errors below this count as this."""

SHARPNESS = 1.0
"""Runs are drawn in proportion to this power of the error expected in them."""

STEEPEST = 2.0
"""Errors grow at most with this power of the score, and at least not at all: probes are small."""


@dataclass(frozen=True)
class ExpectedError:
    """What error goes with which score, place by place."""

    height: Float[np.ndarray, " P"]
    """log error at a score of 1."""
    slope: float
    lowest: float
    highest: float
    """Range of the scores' logarithms that the probe had."""

    @classmethod
    def fitted(
        cls,
        scores: Float[np.ndarray, "N T"],
        errors: Float[np.ndarray, "N T"],
        place: Int[np.ndarray, " N"],
        places: int,
    ) -> ExpectedError:
        """Return the line by least squares, with a height of its own for each place."""
        x = np.log(np.maximum(scores, LEAST))
        y = np.log(np.maximum(errors, LEAST))
        rows = np.repeat(place, scores.shape[1])
        x, y = x.ravel(), y.ravel()
        x_mean = _means(x, rows, places)
        y_mean = _means(y, rows, places)
        apart = x - x_mean[rows]
        steepness = (apart @ (y - y_mean[rows])) / max(apart @ apart, LEAST)
        slope = float(np.clip(steepness, 0, STEEPEST))
        return cls(y_mean - slope * x_mean, slope, float(x.min()), float(x.max()))

    def of(
        self, scores: Float[np.ndarray, "N T"], place: Int[np.ndarray, " N"]
    ) -> Float[np.ndarray, " N"]:
        """Return the mean error to be expected in each run."""
        x = np.clip(np.log(np.maximum(scores, LEAST)), self.lowest, self.highest)
        return np.exp(self.height[place][:, None] + self.slope * x).mean(axis=1)


def _means(
    values: Float[np.ndarray, " M"], rows: Int[np.ndarray, " M"], count: int
) -> Float[np.ndarray, " P"]:
    """Return the mean of the values of each of `count` places; of one without any, of all."""
    sums = np.bincount(rows, values, count)
    numbers = np.bincount(rows, minlength=count)
    return np.where(numbers > 0, sums / np.maximum(numbers, 1), values.mean())


def chosen(
    rng: np.random.Generator, stretches: Stretches, expected: Float[np.ndarray, " N"], count: int
) -> Stretches:
    """Return `count` of the runs, drawn in proportion to the error expected in them, none twice."""
    weights = expected**SHARPNESS
    rows = rng.choice(len(weights), count, replace=False, p=weights / weights.sum())
    return stretches.rows(np.sort(rows))
