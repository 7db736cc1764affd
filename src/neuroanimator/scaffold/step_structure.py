"""What calls of a step function show of its state: what goes round, what may stand anywhere, what is whose rate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.state.units import rate_unit

Step = Callable[[Float[np.ndarray, "N S"]], Float[np.ndarray, "N S"]]
"""One step of many states, each under a control of its own."""

TURN = 2 * np.pi
"""A whole turn [rad]."""

SHIFTS = (0.31, -4.7, 53.0)
"""Multiples of the trial states' spread by which what may stand anywhere is shifted."""

TOLERANCE = 1e-6
"""Answers are the same to within this share of what the entry does in trial runs: sines of large angles round."""

RATE_ERROR = 0.15
"""An entry is another's rate if their rms difference is less than this share of the rate's own rms."""


def wrapped(angle: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """Return angles [rad] less the whole turns in them, from -pi to pi."""
    return np.asarray((angle + np.pi) % TURN - np.pi)


def turning_entries(
    step: Step, states: Float[np.ndarray, "N S"], units: list[str]
) -> Bool[np.ndarray, " S"]:
    """Return which entries are angles that may go all the way round: a whole turn more makes no difference but itself."""
    turning = np.zeros(len(units), bool)
    for entry, unit in enumerate(units):
        if unit == "rad":
            turning[entry] = _is_same_after(step, states, entry, TURN, units)
    return turning


def placeless_entries(
    step: Step, states: Float[np.ndarray, "N S"], units: list[str]
) -> Bool[np.ndarray, " S"]:
    """Return which entries may be anywhere: wherever they are, everything changes as it did."""
    placeless = np.zeros(len(units), bool)
    spread = np.maximum(states.std(axis=0), TOLERANCE)
    for entry in range(len(units)):
        shifts = [share * spread[entry] for share in SHIFTS]
        if units[entry] == "rad":
            shifts.append(1.0)
        placeless[entry] = all(
            _is_same_after(step, states, entry, shift, units) for shift in shifts
        )
    return placeless


def _is_same_after(
    step: Step, states: Float[np.ndarray, "N S"], entry: int, shift: float, units: list[str]
) -> bool:
    """Return whether shifting an entry shifts the entry after the step, and nothing else; whole turns are nothing."""
    shifted = states.copy()
    shifted[:, entry] += shift
    usual = step(states)
    found = step(shifted)
    if not np.isfinite(found).all():
        return False
    difference = found - usual
    difference[:, entry] -= shift
    is_angle = np.array([unit == "rad" for unit in units])
    difference[:, is_angle] = wrapped(difference[:, is_angle])
    scale = np.maximum(np.abs(usual).max(axis=0), abs(shift))
    return bool((np.abs(difference) <= TOLERANCE * np.maximum(scale, 1.0)).all())


def rate_entries(
    states: Float[np.ndarray, "N S"],
    following: Float[np.ndarray, "N S"],
    step: float,
    units: list[str],
) -> dict[int, int]:
    """Return {entry: the entry that is its rate of change}, where units and a step of `step` [s] agree."""
    change = following - states
    rates: dict[int, int] = {}
    for entry, unit in enumerate(units):
        slope = change[:, entry]
        if unit == "rad":
            slope = wrapped(slope)
        best = RATE_ERROR
        for other, other_unit in enumerate(units):
            if other_unit != rate_unit(unit):
                continue
            # A step may use the rate before it, after it or between.
            for rate in (states[:, other], following[:, other], (states + following)[:, other] / 2):
                error = _relative_error(slope / step, rate)
                if error < best:
                    best = error
                    rates[entry] = other
    return rates


def _relative_error(slope: Float[np.ndarray, " N"], rate: Float[np.ndarray, " N"]) -> float:
    """Return the rms difference of a slope and a rate over the rate's own rms; infinite if that is zero."""
    rms = float(np.sqrt(np.mean(rate**2)))
    if rms == 0:
        return float("inf")
    return float(np.sqrt(np.mean((slope - rate) ** 2))) / rms
