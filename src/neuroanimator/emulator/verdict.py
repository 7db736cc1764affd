"""Verdict on an emulator, in one word and with the reasons."""

from __future__ import annotations

import math
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.arrays import array_fields, zeros
from neuroanimator.emulator.error_bounds import KINDS, ErrorBounds
from neuroanimator.state.arrays import AnyArray

NO_CHANGE = "persistence"
"""The predictor that nothing changes; it needs no data."""

CONSTANT_VELOCITY = "constant velocity"
"""The predictor that all velocities stay; it needs no data."""

USELESS = "useless"
"""The word for an emulator that is no better than a guess without one."""

POOR = "poor"
"""The word for an emulator that has learnt something, but not enough, or that often leaves physics."""

USABLE = "usable"
"""The word for an emulator with flaws."""

GOOD = "good"
"""The word for an emulator through which controllers are found that hold on the physics."""

USABLE_SHARE = 0.5
"""Maximum error of a usable emulator as a share of the best cheap predictor's: above it, less than half of the motion
is learnt."""

GOOD_ERROR = 0.1
"""Maximum one-step error of a good emulator [the change's standard deviation]: controllers found through such ones held
on the physics."""

MANY_DIVERGED = 0.1
"""Share of long rollouts that leave physics above which an emulator is poor."""

SOME_DIVERGED = 0.001
"""Share of long rollouts that leave physics above which an emulator is not good."""

AT_THE_NOISE = 1.1
"""Multiple of the noise's error below which an error cannot be told from noise."""

NOISE_TOLD = 0.1
"""Minimum share of noise in an error for the noise to be mentioned."""

BOUND_LEVEL = 0.8
"""Level of the bound that is judged if only bounds are known: the nearest to root mean squares for shipped emulators."""

LOST = 1.0
"""Rollout error, relative to how far a run gets, at which predicting no motion is as good."""

LOST_SHARE = 0.15
"""Error a second, over the body's size, above which a soft body's motion is clearly not the physics'."""

STRAY_SHARE = 0.08
"""The same above which an emulator of a soft body is poor: its folds differ from the physics'."""

FAITHFUL_SHARE = 0.03
"""The same up to which an emulator of a soft body is good."""

IN_WORDS = {
    NO_CHANGE: "predicting no change",
    CONSTANT_VELOCITY: "predicting that velocities stay as they are",
}
"""The cheap predictors that need no data, as reasons name them."""


class WindowErrors(eqx.Module):
    """Errors of a soft body's nodes after the longest validation windows of training.

    Root mean square, over the body's size.
    """

    seconds: Float[AnyArray, ""]
    """Length of the windows [s]."""
    emulator: Float[AnyArray, ""]
    no_change: Float[AnyArray, ""]
    """Error of predicting that it keeps its shape and moves along with its movers."""

    @property
    def in_words(self) -> str:
        """The error as half a sentence."""
        return (
            f"after {float(self.seconds):.2g} s its nodes are off by {float(self.emulator):.1%} "
            "of the body's size"
        )

    def judged(self, verdict: Verdict) -> Verdict:
        """Return the verdict by the windows; `verdict`, on one super step, if it is useless.

        Errors of one step are mostly in the rates of wrinkles, which die out at once.
        """
        if verdict.is_useless:
            return verdict
        # Errors grow about linearly up to a second; then they are as large as motions.
        seconds = min(float(self.seconds), 1.0)
        error = float(self.emulator)
        cheap = float(self.no_change)
        beside = f"{self.in_words}, and by {cheap:.1%} if it just kept its shape"
        if error >= cheap:
            return Verdict(USELESS, (beside,))
        if error > LOST_SHARE * seconds:
            return Verdict(USELESS, (self.in_words,))
        if error > USABLE_SHARE * cheap or error > STRAY_SHARE * seconds:
            return Verdict(POOR, (beside,))
        if error > FAITHFUL_SHARE * seconds:
            return Verdict(USABLE, (self.in_words,))
        return Verdict(GOOD, (self.in_words,))


class ValidationErrors(eqx.Module):
    """Root mean square validation errors of a super step, over the change's standard deviation."""

    emulator: Float[AnyArray, ""]
    no_change: Float[AnyArray, ""]
    """Error of predicting no change."""
    constant_velocity: Float[AnyArray, ""]
    """Error of predicting that velocities stay."""
    noise: Float[AnyArray, ""]
    """Error of a perfect emulator due to the noise of the recordings; 0 without noise."""
    window: WindowErrors | None = None
    """Errors of a soft body in longer windows; None for other systems."""

    @classmethod
    def blank(cls, *, has_window: bool) -> ValidationErrors:
        """Return blank errors, for a file to fill."""
        window = None
        if has_window:
            window = WindowErrors(zeros(), zeros(), zeros())
        return cls(zeros(), zeros(), zeros(), zeros(), window)

    @property
    def verdict(self) -> Verdict:
        """Whether the emulator is of use within training, and why."""
        cheap = {NO_CHANGE: float(self.no_change), CONSTANT_VELOCITY: float(self.constant_velocity)}
        verdict = judge(float(self.emulator), cheap, noise=float(self.noise))
        if self.window is None:
            return verdict
        return self.window.judged(verdict)

    def check(self) -> None:
        """Refuse values that no error has; raises ValueError."""
        if any(np.asarray(error) < 0 for error in array_fields(self).values()):
            raise ValueError("validation: wanted errors of at least 0")


@dataclass(frozen=True)
class Verdict:
    """A word for an emulator, with reasons."""

    word: str
    """`useless`, `poor`, `usable` or `good`."""
    reasons: tuple[str, ...]
    """Half sentences: its faults, or its merits."""

    @property
    def is_useless(self) -> bool:
        """Whether a guess without an emulator is as good."""
        return self.word == USELESS

    def with_flaw(self, flaw: str) -> Verdict:
        """Return the verdict with another `flaw`, with which no emulator is good."""
        if self.word == GOOD:
            return Verdict(USABLE, (flaw,))
        return Verdict(self.word, (*self.reasons, flaw))

    def because(self, causes: tuple[str, ...]) -> Verdict:
        """Return the verdict with the `causes` of its faults; unchanged if it is good."""
        if self.word == GOOD:
            return self
        return Verdict(self.word, (*self.reasons, *causes))

    def __str__(self) -> str:
        """Return the word and its reasons."""
        return f"{self.word}: {'; '.join(self.reasons)}"


def judge(
    error: float,
    cheap: dict[str, float],
    *,
    diverged: int = 0,
    rollouts: int = 0,
    error_after_second: float = 0.0,
    noise: float = 0.0,
    level: float | None = None,
) -> Verdict:
    """Return the verdict on a one-step `error`, in standard deviations of the change, that may be NaN or infinite.

    `cheap` are the errors of predictors that need no emulator; `diverged` of `rollouts` rollouts left physics;
    `error_after_second` is the rollout error after a second, relative to how far runs get. `noise` is the error that a
    perfect emulator would have on the same recordings: its part of the error is not the emulator's fault. `level` is the
    share of motions whose errors are at most `error`, if that is not a root mean square.
    """
    without_data = {name: value for name, value in cheap.items() if name in IN_WORDS}
    reason = _why_useless(error, without_data, noise)
    if reason:
        return Verdict(USELESS, (reason,))
    share = diverged / rollouts if rollouts else 0.0
    own_error = beyond_noise(error, noise)
    on_error = _error_in_words(error, noise, level)
    on_divergence = f"{diverged:,} of {rollouts:,} long rollouts diverged"
    faults = []
    if without_data and own_error > USABLE_SHARE * min(without_data.values()):
        best = min(without_data, key=lambda name: without_data[name])
        faults.append(f"{on_error}, {IN_WORDS[best]} by no more than {without_data[best]:.2g}")
    if share > MANY_DIVERGED:
        faults.append(on_divergence)
    if faults:
        return Verdict(POOR, tuple(faults))
    flaws = []
    if own_error > GOOD_ERROR:
        flaws.append(on_error)
    if share > SOME_DIVERGED:
        flaws.append(on_divergence)
    if not error_after_second < LOST:
        flaws.append("after a second it is off by as much as runs move")
    if flaws:
        return Verdict(USABLE, tuple(flaws))
    merits = [on_error]
    if rollouts:
        merits.append(on_divergence)
    return Verdict(GOOD, tuple(merits))


def beyond_noise(error: float, noise: float) -> float:
    """Return an error without the part due to noise: the two are independent, so their squares add up."""
    return math.sqrt(max(0.0, error**2 - noise**2))


def judge_bounds(bounds: ErrorBounds) -> Verdict:
    """Return the verdict on the `bounds` of one super step."""
    error = bounds.usual(BOUND_LEVEL, KINDS[0])[0]
    # They are in standard deviations of the change, which is the least error of predicting no change.
    return judge(float(error), {NO_CHANGE: 1.0}, level=BOUND_LEVEL)


def _error_in_words(error: float, noise: float, level: float | None) -> str:
    """Return half a sentence on a one-step error, with the part due to noise if that is worth mentioning."""
    told = f"one step is off by {error:.2g} of the change's standard deviation"
    if level is not None:
        told += f" at most, in {level:.0%} of motions"
    if noise >= NOISE_TOLD * error:
        told += f", of which the recordings' own noise makes {noise:.2g}"
    return told


def _why_useless(error: float, without_data: dict[str, float], noise: float) -> str:
    """Return why an emulator is useless; empty if it is not, or if noise hides it."""
    if not math.isfinite(error):
        return "its predictions are not even finite"
    if error <= AT_THE_NOISE * noise:
        return ""
    beaten_by = [name for name, value in without_data.items() if error >= value]
    if not beaten_by:
        return ""
    named = NO_CHANGE if NO_CHANGE in beaten_by else beaten_by[0]
    return (
        f"it is worse than {IN_WORDS[named]} "
        f"({error:.2g} against {without_data[named]:.2g} of the change's deviation)"
    )
