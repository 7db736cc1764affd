"""Growth of errors with the score of `Emulator.trust`: whether users may rely on it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Quantiles of the super steps that bound the bands: fine at high scores, where errors matter."""

FEWEST = 5
"""Minimum number of super steps in a band: fewer mean nothing."""


@dataclass(frozen=True)
class TrustBand:
    """The one-step errors of super steps with similar scores, in standard deviations of the change."""

    middle: float
    """Median score."""
    median: float
    large: float
    """Quantile 0.95 of the errors."""


def trust_bands(
    scores: Float[np.ndarray, " N"], errors: Float[np.ndarray, " N"]
) -> tuple[TrustBand, ...]:
    """Return the bands of super steps by `scores`, lowest first; none where all scores are equal, or not finite."""
    is_finite = np.isfinite(scores) & np.isfinite(errors)
    scores, errors = scores[is_finite], errors[is_finite]
    if not len(scores) or np.ptp(scores) == 0:
        return ()
    order = np.argsort(scores, kind="stable")
    edges = np.round(np.array(SHARES) * len(order)).astype(int)
    bands = []
    for first, last in itertools.pairwise(edges):
        rows = order[first:last]
        if len(rows) < FEWEST:
            continue
        bands.append(
            TrustBand(
                middle=float(scores[rows[len(rows) // 2]]),
                median=float(np.median(errors[rows])),
                large=float(np.quantile(errors[rows], 0.95)),
            )
        )
    return tuple(bands)
