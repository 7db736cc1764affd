"""How errors grow with the score of `Emulator.trust`: whether a user may go by it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Bands hold these shares of the super steps: fine where scores are high, for there errors are of interest."""

FEWEST = 5
"""A band of fewer super steps tells nothing."""


@dataclass(frozen=True)
class TrustBand:
    """The one-step errors of super steps whose scores are alike, in standard deviations of the change."""

    middle: float
    """The median score."""
    median: float
    large: float
    """95 of a hundred errors are smaller."""


def trust_bands(
    scores: Float[np.ndarray, " N"], errors: Float[np.ndarray, " N"]
) -> tuple[TrustBand, ...]:
    """Return the bands of super steps by `scores`, lowest first; none where all scores are alike, or not finite."""
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
