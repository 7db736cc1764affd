"""One-line summary of how far to trust a whole motion of an emulator."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.emulator.verdict import Verdict

FAR_SCORE = 10.0
"""Score above which a motion is called far outside training: there emulators were seen to invent speeds and tilts."""

UNJUDGED = "the file does not say how good it is there; 'neuroanimator evaluate' does"
"""Text for a file without errors."""

NO_METER = "the file is too old to have trust scores; na.fit_trust(emulator, data) adds them"
"""Text for a file without a meter."""


class TrustSummary(NamedTuple):
    """Summary of the scores of a motion's super steps."""

    share_within: float
    """Share of super steps that score at most 1, which are within training."""
    highest: float
    highest_at: float
    """Start time of the super step with the highest score [s]."""
    verdict: Verdict | None = None
    """Whether the emulator is of use within training; None if its file has no errors."""
    has_meter: bool = True
    """Whether there are scores of a meter; older files know only ranges."""
    far_from: float | None = None
    """Start time of the first super step that scores above `FAR_SCORE` [s]; None if none does."""

    def __str__(self) -> str:
        """Return the share within training, and how good the emulator is there."""
        if self.verdict is None:
            return f"{self._share_in_words}; {UNJUDGED}"
        return f"{self._share_in_words}; there the emulator is {self.verdict}"

    @property
    def _share_in_words(self) -> str:
        if not self.has_meter:
            return f"{self.share_within:.0%} of it within the ranges of training ({NO_METER})"
        if self.share_within == 1:
            return f"all of it within training (highest score {self.highest:.2f}, edge {EDGE:g})"
        told = (
            f"{self.share_within:.0%} of it within training, highest score {self.highest:.2f} "
            f"at {self.highest_at:.2f} s (edge {EDGE:g})"
        )
        if self.far_from is not None:
            told += f"; from {self.far_from:.2f} s on it is far outside: do not rely on the motion there"
        return told


def summary_of(emulator: Emulator, scores: Float[np.ndarray, " T"]) -> TrustSummary:
    """Return the summary of the `scores` of at least one super step, as returned by `Emulator.rollout_trusted`."""
    highest = int(np.argmax(scores))
    far = np.flatnonzero(scores > FAR_SCORE)
    return TrustSummary(
        share_within=float(np.mean(scores <= EDGE)),
        highest=float(scores[highest]),
        highest_at=highest * emulator.dt,
        verdict=emulator.verdict,
        has_meter=emulator.meter is not None,
        far_from=float(far[0] * emulator.dt) if len(far) else None,
    )
