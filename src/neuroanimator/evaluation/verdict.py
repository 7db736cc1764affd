"""Whether an emulator is of any use, in one word and with the reasons."""

from __future__ import annotations

import math
from dataclasses import dataclass

from neuroanimator.evaluation.accuracy import CONSTANT_VELOCITY, NO_CHANGE

USELESS, POOR, USABLE, GOOD = "useless", "poor", "usable", "good"

USABLE_SHARE = 0.5
"""Of the best cheap predictor's error: an emulator that errs by more has learnt less than half of what there is."""
GOOD_ERROR = 0.1
"""Of the change's standard deviation. Controllers found through emulators this good held on the physics."""
MANY_BLOW_UPS, SOME_BLOW_UPS = 0.1, 0.001
"""Shares of long rollouts that leave physics: above the first an emulator is poor, above the second not good."""
LOST = 1.0
"""Rollout error, in how far a run gets, at which one may as well say that the run stays where it began."""

IN_WORDS = {
    NO_CHANGE: "predicting no change",
    CONSTANT_VELOCITY: "predicting that velocities stay as they are",
}


@dataclass(frozen=True)
class Verdict:
    """A word for an emulator, and why."""

    word: str
    """`useless`, `poor`, `usable` or `good`."""
    reasons: tuple[str, ...]
    """Half sentences: what spoils it, or what makes it good."""

    @property
    def is_useless(self) -> bool:
        """Whether a guess that needs no emulator is as good."""
        return self.word == USELESS

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
) -> Verdict:
    """Return the verdict on a one-step `error`, in standard deviations of the change, that may be NaN or infinite.

    `cheap` are the errors of predictors that need no emulator, `diverged` of so many `rollouts` left physics, and
    `error_after_second` is the rollout error after a second, in how far runs get.
    """
    simple = {name: value for name, value in cheap.items() if name in IN_WORDS}
    useless = _why_useless(error, simple)
    if useless:
        return Verdict(USELESS, (useless,))
    share = diverged / rollouts if rollouts else 0.0
    off = f"one step is off by {error:.2g} of the change's standard deviation"
    left = f"{diverged:,} of {rollouts:,} long rollouts blew up"
    faults = []
    if simple and error > USABLE_SHARE * min(simple.values()):
        best = min(simple, key=lambda name: simple[name])
        faults.append(f"{off}, {IN_WORDS[best]} by no more than {simple[best]:.2g}")
    if share > MANY_BLOW_UPS:
        faults.append(left)
    if faults:
        return Verdict(POOR, tuple(faults))
    flaws = []
    if error > GOOD_ERROR:
        flaws.append(off)
    if share > SOME_BLOW_UPS:
        flaws.append(left)
    if not error_after_second < LOST:
        flaws.append("after a second it is off by as much as runs move")
    if flaws:
        return Verdict(USABLE, tuple(flaws))
    return Verdict(GOOD, (off, left) if rollouts else (off,))


def _why_useless(error: float, simple: dict[str, float]) -> str:
    if not math.isfinite(error):
        return "it does not even give finite numbers"
    beaten_by = [name for name, value in simple.items() if error >= value]
    if not beaten_by:
        return ""
    worst = NO_CHANGE if NO_CHANGE in beaten_by else beaten_by[0]
    return f"it is worse than {IN_WORDS[worst]} ({error:.2g} against {simple[worst]:.2g} of the change's deviation)"
