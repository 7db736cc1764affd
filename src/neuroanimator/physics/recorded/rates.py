"""Which columns of a recording are the rates of change of others, and whether angles are in radians, as they claim."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import BadFileError
from neuroanimator.physics.recorded.rotations import entries_in
from neuroanimator.state.units import DEGREE, rate_unit

Runs = Sequence[Float[np.ndarray, "_ S"]]
"""Runs of states of various lengths."""

RATE_ERROR = 0.15
"""Maximum error of an entry as another's rate: the rms difference between its integral and the other's changes, over these."""

DEGREES_ERROR = 0.05
"""The same if the rate is multiplied by the degrees in a radian, or divided: other ratios may be those of gears."""

SPANS = (1, 2, 5, 10, 20, 50)
"""Numbers of samples over which changes are compared: noise stays the same, and the change grows."""

MIN_CHANGES = 8
"""Minimum number of changes for a span to count."""

WHOLE_TURN = 360.0
"""A whole turn [degrees]."""

WRAP_ERROR = 0.2
"""Maximum difference of a jump from a whole turn, as a share of it: the angle moves meanwhile."""


def changes_of(runs: Runs, span: int) -> Float[np.ndarray, "_ S"]:
    """Return the change of each entry over `span` samples, in all runs that are long enough."""
    return np.concatenate([states[span:] - states[:-span] for states in runs])


def rate_entries(runs: Runs, step: float, units: Sequence[str]) -> dict[int, int]:
    """Return {entry: the entry that is its rate of change}, if units and numbers sampled every `step` [s] agree.

    Angles are unwrapped in the runs.
    """
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


def refuse_degrees(file: str, columns: Sequence[tuple[str, str]], runs: Runs, step: float) -> None:
    """Raise BadFileError for an angle or its rate that is in degrees, though its column says radians.

    An angle jumps by the degrees of a whole turn, or one's changes are the other's integral, but for the degrees in a radian.
    Where both are in degrees, they agree with each other.
    """
    speeds = entries_in(columns, "rad/s")
    for angle in entries_in(columns, "rad"):
        jumps = np.abs(changes_of([states[:, [angle]] for states in runs], 1))
        are_turns = np.abs(jumps - WHOLE_TURN) < WRAP_ERROR * WHOLE_TURN
        if are_turns.any() and np.median(jumps) < WRAP_ERROR * WHOLE_TURN:
            raise _in_degrees(file, columns[angle], "it jumps by whole turns of 360")
        for speed in speeds:
            scales = ((WHOLE_TURN, DEGREE, angle, speed), (2 * np.pi, 1 / DEGREE, speed, angle))
            for turn, scale, wrong, right in scales:
                pairs = []
                for states in runs:
                    continuous = np.unwrap(states[:, angle], period=turn)
                    pairs.append(np.stack([scale * continuous, states[:, speed]], axis=1))
                if _rate_error(pairs, step, 0, 1) < DEGREES_ERROR:
                    why = f"it and {columns[right][0]} differ by {1 / DEGREE:.1f}"
                    raise _in_degrees(file, columns[wrong], why)


def _in_degrees(file: str, column: tuple[str, str], why: str) -> BadFileError:
    name, unit = column
    degrees = unit.replace("rad", "deg")
    return BadFileError(
        f"{file}: '{name} {unit}' looks like degrees: {why}. Call it '{name} {degrees}', or convert it to radians."
    )
