"""Readable conditions under which something is several times as large as elsewhere.

A condition is one number beyond one threshold. It is chosen on one half of the runs as a regression tree chooses its
first split, and measured on the other half, which did not choose it: of the many conditions tried, some are always
large by chance, and do not hold there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.learn.evaluation.weakness.readings import Reading

MAX_SPOTS = 4
"""Maximum number of conditions looked for: each one after the first explains less."""

MIN_RATIO = 1.5
"""Minimum ratio of the mean under a condition to the mean elsewhere."""

MIN_SHARE = 0.04
"""Minimum share of the samples that fulfil a condition: fewer would choose it by chance."""

MAX_SHARE = 0.5
"""Maximum share of the samples that fulfil a condition: more are the rule, not the exception."""

MIN_SAMPLES = 20
"""Minimum number of samples in a mean."""

SHARES = tuple(share / 100 for share in range(4, 51, 2))
"""Shares of the samples beyond the thresholds that are tried."""

DIGITS = 2
"""Number of digits to which thresholds are rounded before measuring, so that the condition shown is the one measured."""

OUTLIERS = 0.99
"""Quantile of the values above zero to which larger ones are clipped while a condition is chosen: no sample decides alone."""


@dataclass(frozen=True)
class WeakSpot:
    """A condition under which errors are larger than elsewhere, measured on runs that did not choose it."""

    condition: str
    """The condition in words, such as `|hip.velocity| > 8 rad/s`."""
    ratio: float
    """Mean error there over the mean error elsewhere."""
    error: float
    """Mean error there [standard deviations of the change]."""
    share: float
    """Share of the super steps that fulfil the condition."""
    share_of_error: float
    """Share of the sum of all errors that comes from there."""
    component: str = ""
    """Name of the number of the state with the largest errors there."""

    def __str__(self) -> str:
        """Return it as a sentence."""
        return (
            f"error is {self.ratio:.2g} times that elsewhere where {self.condition} ({self.share:.0%} of samples, "
            f"{self.share_of_error:.0%} of all error), most of all in {self.component}"
        )


class _Condition(NamedTuple):
    reading: int
    text: str
    holds: Bool[np.ndarray, " N"]


def find_spots(
    values: Float[np.ndarray, " N"], runs: Int[np.ndarray, " N"], readings: Sequence[Reading]
) -> list[tuple[WeakSpot, Bool[np.ndarray, " N"]]]:
    """Return where `values` (N,), none below zero, are large, worst first; each with the samples (N,) that fulfil it.

    `runs` (N,) is the run of each sample: samples of one run are alike, so runs are halved, not samples. Each
    condition after the first is looked for outside the earlier ones. Only conditions that hold on the other half of
    the runs are returned, and no reading that cannot matter.
    """
    chooses = np.unique(runs, return_inverse=True)[1] % 2 == 0
    clipped = values
    if values.any():
        clipped = np.minimum(values, np.quantile(values[values > 0], OUTLIERS))
    is_left = np.ones(len(values), dtype=bool)
    spots = []
    candidates = {i: reading for i, reading in enumerate(readings) if reading.can_matter}
    for _ in range(MAX_SPOTS):
        condition = _best(clipped, candidates, chooses & is_left)
        if condition is None or not _measured(values, condition, ~chooses & is_left):
            break
        spot = _measured(values, condition, ~chooses)
        if spot:  # also without leaving out what earlier conditions explain
            spots.append((spot, condition.holds))
        is_left &= ~condition.holds
        # The rest beyond a nearby threshold of the same number is not another spot.
        del candidates[condition.reading]
    return sorted(spots, key=lambda pair: -pair[0].ratio)


def _best(
    values: Float[np.ndarray, " N"], readings: dict[int, Reading], among: Bool[np.ndarray, " N"]
) -> _Condition | None:
    """Return the condition that explains most of the variance of `values` within `among`; None if there is none.

    Its mean must be `MIN_RATIO` times that elsewhere.
    """
    if among.sum() < 2 * MIN_SAMPLES:
        return None
    best = None
    most_explained = 0.0
    values = values[among]
    for condition in _candidates(readings, among):
        holds = condition.holds[among]
        share = holds.mean()
        if not MIN_SHARE <= share <= MAX_SHARE or holds.sum() < MIN_SAMPLES:
            continue
        inside = values[holds].mean()
        outside = values[~holds].mean()
        explained = share * (1 - share) * (inside - outside) ** 2
        if inside > MIN_RATIO * outside and explained > most_explained:
            best = condition
            most_explained = explained
    return best


def _candidates(
    readings: dict[int, Reading], among: Bool[np.ndarray, " N"]
) -> Iterator[_Condition]:
    """Yield every condition to try: thresholds at quantiles of values and magnitudes within `among`, above and below."""
    for number, reading in readings.items():
        unit = "" if reading.unit == "1" else f" {reading.unit}"
        forms = {reading.name: reading.values}
        some = reading.values[among]
        if (some < 0).any() and (some > 0).any():
            forms[f"|{reading.name}|"] = np.abs(reading.values)
        for name, values in forms.items():
            for sign, shares in ((">", [1 - share for share in SHARES]), ("<", SHARES)):
                # Rounded, each once.
                quantiles = np.quantile(values[among], shares)
                for threshold in sorted({float(f"{value:.{DIGITS}g}") for value in quantiles}):
                    holds = values > threshold if sign == ">" else values < threshold
                    yield _Condition(number, f"{name} {sign} {threshold:g}{unit}", holds)


def _measured(
    values: Float[np.ndarray, " N"], condition: _Condition, among: Bool[np.ndarray, " N"]
) -> WeakSpot | None:
    """Return the figures of a condition within `among`; None if values are not `MIN_RATIO` times those elsewhere, or too few."""
    holds = condition.holds[among]
    inside = values[among][holds]
    outside = values[among][~holds]
    if min(len(inside), len(outside)) < MIN_SAMPLES:
        return None
    mean = float(inside.mean())
    elsewhere = float(outside.mean())
    if mean <= MIN_RATIO * elsewhere:
        return None
    return WeakSpot(
        condition=condition.text,
        ratio=mean / elsewhere if elsewhere > 0 else float("inf"),
        error=mean,
        share=float(holds.mean()),
        share_of_error=float(inside.sum() / values[among].sum()),
    )
