"""Where something is several times as large as elsewhere: conditions a person can read, and that hold.

A condition is one number beyond one threshold. It is chosen on one half of the runs as a regression tree chooses its
first split, and measured on the other half, which had no say in it: of the many conditions tried, some are always
large by chance, and those do not hold there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.data.readings import Reading

MAX_SPOTS = 4
"""So many conditions are looked for at most: each one after the first explains less."""

MIN_RATIO = 1.5
"""A condition under which the mean is a smaller multiple of the mean elsewhere is not worth a line."""

MIN_SHARE = 0.04
"""A condition that fewer samples fulfil is not looked for: it would be chosen by a few samples."""

MAX_SHARE = 0.5
"""A condition that more samples fulfil is the rule, not a spot."""

MIN_SAMPLES = 20
"""A mean over fewer samples is not told."""

SHARES = tuple(share / 100 for share in range(4, 51, 2))
"""Thresholds are tried that leave about these shares of the samples beyond them."""

DIGITS = 2
"""Thresholds are rounded to so many digits before anything is measured, so that what is read is what was measured."""

OUTLIERS = 0.99
"""What lies beyond this quantile of those above zero counts as the quantile while a condition is chosen: one sample must
not choose it."""


@dataclass(frozen=True)
class Spot:
    """A condition under which something is larger than elsewhere."""

    condition: str
    """Such as `|hip.velocity| > 8 rad/s`."""
    ratio: float
    """The mean there over the mean elsewhere, measured on the runs that had no say in choosing the condition."""
    mean: float
    """The mean there, on the same runs."""
    share: float
    """Share of the samples that fulfil the condition."""
    share_of_total: float
    """Share of the sum over all samples that comes from there."""


class Condition(NamedTuple):
    """A reading, or its magnitude, above or below a threshold."""

    reading: int
    is_magnitude: bool
    is_above: bool
    threshold: float

    def holds(self, readings: Sequence[Reading]) -> Bool[np.ndarray, " N"]:
        """Return which samples of `readings` fulfil it."""
        values = readings[self.reading].values
        if self.is_magnitude:
            values = np.abs(values)
        if self.is_above:
            return values > self.threshold
        return values < self.threshold

    def text(self, readings: Sequence[Reading]) -> str:
        """Return the condition as it is read."""
        reading = readings[self.reading]
        name = f"|{reading.name}|" if self.is_magnitude else reading.name
        sign = ">" if self.is_above else "<"
        unit = "" if reading.unit == "1" else f" {reading.unit}"
        return f"{name} {sign} {self.threshold:g}{unit}"


def find_spots(
    values: Float[np.ndarray, " N"], runs: Int[np.ndarray, " N"], readings: Sequence[Reading]
) -> list[tuple[Spot, Bool[np.ndarray, " N"]]]:
    """Return where `values` (N,), none below zero, are large, worst first; each with the samples (N,) it holds of.

    `runs` (N,) says which run each sample is of: samples of one run are alike, so runs are halved, not samples. Each
    condition after the first is looked for outside of those before. None is returned that does not hold on the other
    half of the runs, nor any reading that cannot matter.
    """
    numbers = np.unique(runs, return_inverse=True)[1]
    chooses = numbers % 2 == 0
    judges = ~chooses
    clipped = _without_outliers(values)
    is_left = np.ones(len(values), dtype=bool)
    spots = []
    candidates = list(readings)
    for _ in range(MAX_SPOTS):
        condition = _best(clipped, candidates, chooses & is_left)
        if condition is None:
            break
        holds = condition.holds(readings)
        if not _is_confirmed(values, holds, judges & is_left):
            break
        spot = _measured(values, holds, judges, condition.text(readings))
        if spot.ratio >= MIN_RATIO:  # also if what the conditions before explain is not left out
            spots.append((spot, holds))
        is_left &= ~holds
        # What is left beyond a nearby threshold of the same number is no other spot.
        candidates[condition.reading] = readings[condition.reading]._replace(can_matter=False)
    return sorted(spots, key=lambda pair: -pair[0].ratio)


def _without_outliers(values: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    positive = values[values > 0]
    if not len(positive):
        return values
    return np.minimum(values, np.quantile(positive, OUTLIERS))


def _best(
    values: Float[np.ndarray, " N"], readings: Sequence[Reading], among: Bool[np.ndarray, " N"]
) -> Condition | None:
    """Return the condition that explains most of the variance of `values` among some samples; None if there is none.

    Its mean must be `MIN_RATIO` times that elsewhere.
    """
    if among.sum() < 2 * MIN_SAMPLES:
        return None
    best = None
    most_explained = 0.0
    chosen = [reading._replace(values=reading.values[among]) for reading in readings]
    values = values[among]
    for condition in _candidates(chosen):
        holds = condition.holds(chosen)
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


def _candidates(readings: Sequence[Reading]) -> Iterator[Condition]:
    """Yield every condition to try: thresholds at quantiles, from above and below, of magnitudes too."""
    for number, reading in enumerate(readings):
        if not reading.can_matter:
            continue
        has_both_signs = bool((reading.values < 0).any() and (reading.values > 0).any())
        for is_magnitude in (False, True) if has_both_signs else (False,):
            values = np.abs(reading.values) if is_magnitude else reading.values
            for threshold in _rounded(np.quantile(values, [1 - share for share in SHARES])):
                yield Condition(number, is_magnitude, True, threshold)
            for threshold in _rounded(np.quantile(values, SHARES)):
                yield Condition(number, is_magnitude, False, threshold)


def _rounded(thresholds: Float[np.ndarray, " K"]) -> list[float]:
    """Return the thresholds with a few digits, each once."""
    return sorted({float(f"{threshold:.{DIGITS}g}") for threshold in thresholds})


def _is_confirmed(
    values: Float[np.ndarray, " N"], holds: Bool[np.ndarray, " N"], among: Bool[np.ndarray, " N"]
) -> bool:
    """Return whether the mean is larger where a condition `holds` on these samples, too."""
    inside = values[holds & among]
    outside = values[~holds & among]
    if min(len(inside), len(outside)) < MIN_SAMPLES:
        return False
    return bool(inside.mean() > MIN_RATIO * outside.mean())


def _measured(
    values: Float[np.ndarray, " N"],
    holds: Bool[np.ndarray, " N"],
    judges: Bool[np.ndarray, " N"],
    condition: str,
) -> Spot:
    """Return what is told of a condition, measured on all samples that `judges` selects."""
    inside = values[holds & judges]
    outside = values[~holds & judges]
    mean = float(inside.mean())
    elsewhere = float(outside.mean())
    return Spot(
        condition=condition,
        ratio=mean / elsewhere if elsewhere > 0 else float("inf"),
        mean=mean,
        share=float(holds[judges].mean()),
        share_of_total=float(inside.sum() / values[judges].sum()),
    )
