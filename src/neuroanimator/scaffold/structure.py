"""Structure of a state, inferred from trial calls or recordings: angles, entries without an origin, rates of change."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.state.units import rate_unit

States = Float[np.ndarray, "_ S"]
"""States, one in each row."""

Step = Callable[[States], States]
"""One step of many states, each under its own control."""

Runs = Sequence[Float[np.ndarray, "_ S"]]
"""Runs of states of various lengths, with angles unwrapped."""

TURN = 2 * np.pi
"""A whole turn [rad]."""

SHIFTS = (0.31, -4.7, 53.0)
"""Multiples of the trial states' spread by which an entry is shifted to test whether its value matters."""

TOLERANCE = 1e-6
"""Relative difference within which results are equal: sines of large angles are rounded."""

RATE_ERROR = 0.15
"""Maximum error of an entry as another's rate: the rms difference between its integral and the other's changes, over these."""

SPANS = (1, 2, 5, 10, 20, 50)
"""Numbers of samples over which changes are compared: noise stays the same, and the change grows."""

MIN_CHANGES = 8
"""Minimum number of changes for a span to count."""


def wrapped(angle: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """Return angles [rad] without whole turns, from -pi to pi."""
    return np.asarray((angle + np.pi) % TURN - np.pi)


def turning_entries(step: Step, states: States, units: Sequence[str]) -> Bool[np.ndarray, " S"]:
    """Return which entries are angles that may turn all the way round: one more turn changes nothing else."""
    is_turning = [
        unit == "rad" and _is_same_after(step, states, entry, TURN, units)
        for entry, unit in enumerate(units)
    ]
    return np.array(is_turning)


def placeless_entries(step: Step, states: States, units: Sequence[str]) -> Bool[np.ndarray, " S"]:
    """Return which entries have values that do not matter: shifting them leaves all changes the same."""
    is_placeless = []
    for entry, spread in enumerate(np.maximum(states.std(axis=0), TOLERANCE)):
        shifts = [share * spread for share in SHIFTS]
        if units[entry] == "rad":
            shifts.append(1.0)
        is_same = all(_is_same_after(step, states, entry, shift, units) for shift in shifts)
        is_placeless.append(is_same)
    return np.array(is_placeless)


def _is_same_after(
    step: Step, states: States, entry: int, shift: float, units: Sequence[str]
) -> bool:
    """Return whether shifting an entry shifts that entry after the step, and nothing else, up to whole turns."""
    offset = np.zeros(len(units))
    offset[entry] = shift
    usual = step(states)
    found = step(states + offset)
    if not np.isfinite(found).all():
        return False
    difference = found - usual - offset
    is_angle = np.array(units) == "rad"
    difference[:, is_angle] = wrapped(difference[:, is_angle])
    scale = np.maximum(np.abs(usual).max(axis=0), abs(shift))
    return bool((np.abs(difference) <= TOLERANCE * np.maximum(scale, 1.0)).all())


def rate_entries(runs: Runs, step: float, units: Sequence[str]) -> dict[int, int]:
    """Return {entry: the entry that is its rate of change}, if units and numbers sampled every `step` [s] agree."""
    rates: dict[int, int] = {}
    for entry, unit in enumerate(units):
        best = RATE_ERROR
        for other, other_unit in enumerate(units):
            if other_unit != rate_unit(unit):
                continue
            error = _rate_error(runs, step, entry, other)
            if error < best:
                best = error
                rates[entry] = other
    return rates


def _rate_error(runs: Runs, step: float, entry: int, other: int) -> float:
    """Return the error of one entry's integral against the other's changes, as a share of these; the smallest over `SPANS`.

    Infinite if the runs are too short, or if nothing changes.
    """
    errors = [float("inf")]
    # A step may use the rate before it, after it or between.
    for share in (0.0, 0.5, 1.0):
        sums = []
        for states in runs:
            rate = (1 - share) * states[:-1, other] + share * states[1:, other]
            sums.append(np.concatenate([[0.0], np.cumsum(rate)])[:, None] * step)
        for span in SPANS:
            added = changes_of(sums, span)
            rms = np.sqrt(np.mean(added**2)) if len(added) >= MIN_CHANGES else 0.0
            if rms > 0:
                difference = changes_of(runs, span)[:, [entry]] - added
                errors.append(float(np.sqrt(np.mean(difference**2)) / rms))
    return min(errors)


def changes_of(runs: Runs, span: int) -> States:
    """Return the change of each entry over `span` samples, in all runs that are long enough."""
    return np.concatenate([states[span:] - states[:-span] for states in runs])
