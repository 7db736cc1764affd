"""The clock of a recording, judged by what its times can mean: the digits they were written with, and their type.

Times in milliseconds at 120 samples a second are 0, 8, 17, 25 ms apart from zero: that is a constant rate, rounded. A rate
is constant if over every span of m samples of step h

    |t_{k+m} - t_k - m h| ≤ r + ε m h

where r is the resolution of the times and ε the error of real clocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Num

from neuroanimator.files.number_table import last_place

RATE_ERROR = 1e-3
"""Relative error of the rates of real clocks; they are better than that."""

GAP = 0.2
"""Difference of a single interval from the usual one, as a share of it, from which rows are missing or repeated there."""

GAPS_SHARE = 0.05
"""Share of such intervals above which the clock is at fault, not gaps."""

FEW_GAPS = 3
"""Number of such intervals up to which they count as gaps, also in a short recording."""

ROUNDING = 1e-6
"""Relative difference within which a round number stands for a step: the one that was meant."""

SURE = 3.0
"""Number of standard deviations of a fitted step within which a round number stands for it."""

COARSEST = 10.0
"""Largest resolution, in samples, with which a clock still tells a rate."""

DIGITS = 17
"""Number of digits that tell any number."""

SAMPLED = 1000
"""Number of times looked at to tell single precision."""


Times = Float[np.ndarray, " N"]
"""A time for each row [s], or its resolution."""

Intervals = Bool[np.ndarray, " G"]
"""Something that is or is not so between each row and the next."""


@dataclass(frozen=True)
class Clock:
    """The constant rate of a recording, and where it departs from it."""

    step: float
    """Interval between two samples [s]: the roundest one that its times can mean."""
    gaps: Int[np.ndarray, " G"]
    """Rows after which the next one comes too late, or too early."""
    wrong: Int[np.ndarray, " W"]
    """All rows after which the next one is not a step later; the same if the clock is steady between its gaps."""

    @property
    def is_steady(self) -> bool:
        """Whether every sample lies where a constant rate puts it."""
        return not len(self.wrong)

    @property
    def has_gaps_only(self) -> bool:
        """Whether the rate is constant between gaps."""
        return len(self.wrong) == len(self.gaps)


def resolution_of(
    times: Num[np.ndarray, " N"], places: Int[np.ndarray, " N"] | None = None
) -> Times:
    """Return the smallest differences that times can tell, by their type and the `places` of their last written digits.

    Zeros at the end may have been left out: the finest place in a decade of times counts for all of them.
    """
    if times.dtype.kind in "iu":
        return np.ones(len(times))
    numbers = times.astype(float)
    if times.dtype.itemsize < numbers.dtype.itemsize:
        return np.abs(np.spacing(times)).astype(float)
    resolution = np.abs(np.spacing(numbers))
    if _are_single(numbers):
        resolution = np.abs(np.spacing(numbers.astype(np.float32))).astype(float)
    if places is None:
        places = np.array([last_place(repr(number)) for number in numbers.tolist()])
    # Zero has no decade of its own: it is written like the finest time.
    finest = np.where(numbers == 0, places.min(initial=0), places)
    decades = np.floor(np.log10(np.where(numbers == 0, 1.0, np.abs(numbers))))
    decades[numbers == 0] = -np.inf
    for decade in np.unique(decades):
        is_here = decades == decade
        resolution[is_here] += 10.0 ** float(finest[is_here].min())
    return resolution


def _are_single(times: Times) -> bool:
    """Return whether all times are numbers in single precision, as they are or as they are written."""
    some = times[:: -(-len(times) // SAMPLED) or 1]
    single = some.astype(np.float32)
    written = np.array([float(str(value)) for value in single])
    return bool(((some == single) | (some == written)).all())


def clock_of(
    times: Times,
    resolution: Times,
    is_inside: Intervals,
) -> Clock:
    """Return the clock of rows at `times` [s]; `is_inside` says of each but the last whether the next is of the same run.

    Its step is 0 if time stands still, or if its resolution is too coarse to tell.
    """
    intervals = np.diff(times)
    inside = intervals[is_inside]
    usual = float(np.median(inside)) or float(inside.mean())
    off = np.abs(intervals - usual)
    odd = np.flatnonzero(is_inside & (off > GAP * usual))
    are_few = len(odd) <= max(FEW_GAPS, GAPS_SHARE * len(inside))
    # A rate slightly off that of the times' own digits skips one of these now and then, evenly.
    finest = np.maximum(resolution[1:], resolution[:-1])
    are_even = len(odd) >= FEW_GAPS and (off[odd] <= finest[odd] * (1 + ROUNDING)).all()
    if are_even or not are_few:
        clock = _clock_between(times, resolution, is_inside, odd[:0])
        if clock.is_steady or not are_few:
            return clock
    return _clock_between(times, resolution, is_inside, odd)


def _clock_between(
    times: Times,
    resolution: Times,
    is_inside: Intervals,
    gaps: Int[np.ndarray, " K"],
) -> Clock:
    """Return the clock of rows that have these gaps."""
    is_joined = is_inside.copy()
    is_joined[gaps] = False
    section = np.concatenate([[0], np.cumsum(~is_joined)])
    usual = float(np.median(np.diff(times)[is_inside]))
    coarse = float(np.median(resolution))
    step, margin = _step(times, section, usual, coarse)
    is_wrong = _are_off(times, resolution, section, step, margin)
    is_wrong[gaps] = True
    if coarse > COARSEST * step:
        step = 0.0
    return Clock(step, gaps, np.flatnonzero(is_wrong))


def _are_off(
    times: Times,
    resolution: Times,
    section: Int[np.ndarray, " N"],
    step: float,
    margin: float,
) -> Intervals:
    """Return after which rows a span begins that `step`, which is known up to `margin`, does not explain."""
    is_off = np.zeros(len(times) - 1, bool)
    span = 1
    while span < len(times):
        is_same = section[span:] == section[:-span]
        if not is_same.any():
            break
        off = np.abs(times[span:] - times[:-span] - span * step)
        limit = np.maximum(resolution[span:], resolution[:-span]) * (1 + ROUNDING)
        is_off[: len(off)] |= is_same & (off > limit + (RATE_ERROR * step + margin) * span)
        span *= 2
    return is_off


def _step(
    times: Times, section: Int[np.ndarray, " N"], usual: float, finest: float
) -> tuple[float, float]:
    """Return the step that fits the times of all sections best, and its margin within which it is a round number or rate."""
    counts = np.bincount(section)
    begins = np.cumsum(counts) - counts
    number = np.arange(len(times)) - begins[section]
    since = times - times[begins][section]
    number = number - (np.bincount(section, number) / counts)[section]
    since = since - (np.bincount(section, since) / counts)[section]
    weight = float(number @ number)
    step = usual
    error = 0.0
    if weight:
        step = float(number @ since) / weight
        error = SURE * float((since - step * number).std()) / np.sqrt(weight)
    margin = max(error, finest / int(counts.max()), ROUNDING * abs(step))
    for digits in range(1, DIGITS):
        rate = float(f"{1 / step:.{digits}g}") if step > 0 else np.inf
        for rounded in (1 / rate, float(f"{step:.{digits}g}")):
            if abs(rounded - step) <= margin:
                return rounded, margin
    return step, margin


def straightened(times: Times, resolution: Times) -> Times:
    """Return times at the constant rate that they can mean; unchanged if there is none."""
    if len(times) < 2:
        return times
    clock = clock_of(times, resolution, np.ones(len(times) - 1, bool))
    if not clock.is_steady or not clock.step:
        return times
    even = clock.step * np.arange(len(times))
    return even + np.median(times - even)
