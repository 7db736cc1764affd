"""The time scale of a system: times that suit robots and animals must be stretched for rooms and ponds."""

from __future__ import annotations

USUAL_STEP = 0.1
"""Super step [s] for which all default times are meant."""

SLOW_STEP = 0.5
"""Super step [s] above which a system is slow."""


def slowness(dt: float) -> float:
    """Return the factor on default times for a system of super step `dt` [s]; 1 unless it is slow."""
    if dt <= SLOW_STEP:
        return 1.0
    return dt / USUAL_STEP
