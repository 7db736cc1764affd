"""Error bounds of rollouts, which a given share of motions stays below, measured on runs held out from training.

An error is the root mean square over all numbers of a state that move, each in standard deviations of its usual change in
a super step. Its bound grows as a power of the scores on the way (`Emulator.trust`), so that it adapts to the motion:

    bound after h super steps = exp(a + b (log r - c)), where r is the root mean square of the first h scores, c the mean of
    log r over motions as in training, and a and b depend on kind of motion, level and h: exp(a) is a usual motion's bound
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.arrays import zeros
from neuroanimator.errors import BadFileError
from neuroanimator.files.numbers import numbers, whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.layout import MAX_NUMBERS
from neuroanimator.state.structure import Structure

LEVELS = (0.5, 0.8, 0.9, 0.95)
"""Levels of bounds: shares of motions that stay below them."""

USUAL_LEVEL = 0.9
"""Default level of bounds."""

KINDS = ("random", "optimised")
"""Kinds of motions with their own bounds: under controls as in training, and under controls found by descents."""

LEAST_SCORE = 1e-2
"""Offset added to scores before the logarithm: smaller differences are meaningless."""

MOST_SCORE = 1e3
"""Maximum score: larger ones, also infinite ones, are clipped to it."""

WORDS_SHARES = (0.25, 0.5, 1.0)
"""Shares of the measured time at which errors are stated in words."""

MOST_EXPONENT = 50.0
"""Maximum logarithm of bounds, and maximum power: the logarithm of a million is 14."""

MAX_LEVELS = 32
"""Maximum number of levels in a file."""

MAX_HORIZON = 4096
"""Maximum number of super steps with error bounds in a file."""


class ErrorBounds(eqx.Module):
    """Bounds of the error of rollouts, by kind of motion, level and number of super steps."""

    unit: Float[AnyArray, " V"]
    """Standard deviation of each number's usual change in a super step, in the body's frame; 0 if it never moves."""
    weights: Float[AnyArray, "K L H 2"]
    """(a, b) of the formula above, for each of K kinds, L levels and H super steps."""
    centre: Float[AnyArray, " H"]
    """c of the formula above."""
    levels: tuple[float, ...] = eqx.field(static=True, default=LEVELS)

    def to_json(self) -> dict[str, Any]:
        """Return the sizes of the arrays, and the levels."""
        kinds, _, steps, _ = self.weights.shape
        return {"kinds": kinds, "levels": self.levels, "steps": steps, "numbers": len(self.unit)}

    @classmethod
    def blank(cls, described: dict[str, Any]) -> ErrorBounds:
        """Return blank bounds of the sizes that `to_json` wrote, for a file to fill."""
        levels = numbers(described["levels"], "errors: levels")
        if not 1 <= len(levels) <= MAX_LEVELS or list(levels) != sorted({*levels}):
            raise ValueError(f"errors: wanted 1 to {MAX_LEVELS} levels that rise")
        if not 0 < levels[0] <= levels[-1] < 1:
            raise ValueError("errors: wanted levels between 0 and 1")
        kinds = whole(described["kinds"], "errors: kinds", 1, len(KINDS))
        steps = whole(described["steps"], "errors: steps", 1, MAX_HORIZON)
        unit = zeros(whole(described["numbers"], "errors: numbers", 1, MAX_NUMBERS))
        return cls(unit, zeros(kinds, len(levels), steps, 2), zeros(steps), levels)

    @property
    def steps(self) -> int:
        """Number of super steps with bounds."""
        return self.weights.shape[2]

    @property
    def knows_optimised(self) -> bool:
        """Whether there are bounds for motions under controls found by descents."""
        return self.weights.shape[0] > 1

    def _weights_of(self, level: float, kind: str) -> Float[np.ndarray, "H 2"]:
        return np.asarray(self.weights, float)[KINDS.index(kind), self.levels.index(level)]

    def along(
        self, scores: Float[np.ndarray, "*B T"], level: float, kind: str
    ) -> Float[np.ndarray, "*B T"]:
        """Return the bound after each super step of motions with these scores; infinite after H super steps."""
        bounds = np.full(scores.shape, np.inf)
        known = min(self.steps, scores.shape[-1])
        weights = self._weights_of(level, kind)
        size = log_scores(scores[..., :known]) - np.asarray(self.centre, float)[:known]
        bounds[..., :known] = np.exp(weights[:known, 0] + weights[:known, 1] * size)
        return bounds

    def usual(self, level: float, kind: str) -> Float[np.ndarray, " H"]:
        """Return the bound after each super step of a motion with the usual scores."""
        weights = self._weights_of(level, kind)
        return np.exp(weights[:, 0])

    def check(self) -> None:
        """Refuse numbers that no measurement gives; ValueError names them."""
        if (np.asarray(self.unit) < 0).any() or not (np.asarray(self.unit) > 0).any():
            raise ValueError("errors: wanted units of at least 0, and one above")
        for exponents in (self.weights, self.centre):
            if (np.abs(np.asarray(exponents)) > MOST_EXPONENT).any():
                raise ValueError(f"errors: wanted exponents of at most {MOST_EXPONENT:g}")

    def errors(
        self,
        structure: Structure,
        truth: Float[np.ndarray, "*B F S"],
        emulated: Float[np.ndarray, "*B F S"],
    ) -> Float[np.ndarray, "*B F"]:
        """Return the errors, as the bounds define them, of `emulated` trajectories (..., T+1, S) against the truth.

        Raises BadFileError if the bounds belong to another state.
        """
        size = Frame.of(structure, 0.0).change_size(truth.shape[-1])
        if size != len(self.unit):
            raise BadFileError(
                f"The emulator's error bounds are of {len(self.unit)} numbers, its state changes by {size}. "
                "na.fit_error_bounds(emulator) measures them anew."
            )
        return errors_in(np.asarray(self.unit, float), structure, truth, emulated)


def errors_in(
    unit: Float[np.ndarray, " V"],
    structure: Structure,
    truth: Float[np.ndarray, "*B F S"],
    emulated: Float[np.ndarray, "*B F S"],
) -> Float[np.ndarray, "*B F"]:
    """Return the rms difference of moving numbers, in units (V,) of their usual change; a unit is 0 for those that never move."""
    moves = unit > 0
    differences = Frame.of(structure, 0.0).difference(truth, np.asarray(emulated, float))
    return np.sqrt(np.mean((differences[..., moves] / unit[moves]) ** 2, axis=-1))


def log_scores(scores: Float[np.ndarray, "*B T"]) -> Float[np.ndarray, "*B T"]:
    """Return the logarithm of the root mean square of all scores up to each super step."""
    squares = np.minimum(scores, MOST_SCORE) ** 2
    counts = np.arange(1, scores.shape[-1] + 1)
    return np.log(np.sqrt(np.cumsum(squares, axis=-1) / counts) + LEAST_SCORE)


def bounds_in_words(bounds: ErrorBounds, dt: float) -> str:
    """Return, in words, the errors of motions with usual scores after a quarter, half and all of the measured time."""
    steps = [max(1, round(share * bounds.steps)) for share in WORDS_SHARES]
    after = ", ".join(f"{step * dt:.3g}" for step in steps)
    texts = []
    for kind in KINDS[: len(bounds.weights)]:
        usual = bounds.usual(USUAL_LEVEL, kind)
        figures = ", ".join(f"{usual[step - 1]:.2g}" for step in steps)
        texts.append(f"{figures} under {kind} controls")
    unit = f"after {after} s, in standard deviations of a super step's change"
    return f"{USUAL_LEVEL:.0%} of motions by at most {'; '.join(texts)} ({unit})"
