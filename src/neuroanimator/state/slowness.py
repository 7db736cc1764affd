"""The time scale of a system: times that suit robots and animals suit rooms and ponds only if they are stretched."""

from __future__ import annotations

USUAL_STEP = 0.1
"""Super step [s] for which all times are meant that are written down anywhere."""

SLOW_STEP = 0.5
"""A system whose super step is longer [s] is slow."""


def slowness(dt: float) -> float:
    """Return how many times longer than usual everything takes in a system of super step `dt` [s]; 1 unless it is slow."""
    if dt <= SLOW_STEP:
        return 1.0
    return dt / USUAL_STEP
