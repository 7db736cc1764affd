"""The moments of a motion that cost terms look at, and how often."""

from __future__ import annotations

import math
from dataclasses import dataclass

import equinox as eqx

from neuroanimator.control.objective.objective import StateTerm
from neuroanimator.errors import ArgumentError


@dataclass(frozen=True)
class Moments:
    """Which states of a motion a term looks at: those at some times, the last one if there are none, or all since one."""

    times: tuple[float, ...] = ()
    """[s]"""
    lasts: bool = False
    """Whether all states count from the one time on, so that what is compared is a sum over time."""

    @classmethod
    def of(cls, at: float | tuple[float, ...] | None = None, since: float | None = None) -> Moments:
        """Return the moments `at` a time or several [s], or all `since` one; the end if neither is given.

        Raises ArgumentError for both, and for times that are negative or not finite.
        """
        if at is not None and since is not None:
            raise ArgumentError(f"at and since: wanted one of them, came {at} and {since:g} s.")
        if since is not None:
            return cls((_time("since", since),), lasts=True)
        if at is None:
            return cls()
        times = at if isinstance(at, tuple) else (at,)
        return cls(tuple(_time("at", time) for time in times))

    def rows(self, steps: int, dt: float) -> list[int]:
        """Return which states these are of a motion of so many super steps of `dt` [s]; the start is none of those that last."""
        rows = [round(time / dt) for time in self.times]
        if not self.lasts:
            return rows or [steps]
        first = max(1, min(*rows, steps))
        return list(range(first, steps + 1))

    def share(self, dt: float) -> float:
        """Return what residuals are multiplied by, so that a sum over time does not depend on the super step."""
        return math.sqrt(dt) if self.lasts else 1.0


AT_THE_END = Moments()
"""The last state alone."""

ALL_ALONG = Moments((0.0,), lasts=True)
"""Every state but the start."""


def _time(label: str, seconds: float) -> float:
    if not 0 <= seconds < math.inf:
        raise ArgumentError(f"{label}: wanted a time of at least 0 s, came {seconds:g}.")
    return float(seconds)


class TimedTerm(StateTerm):
    """A term that looks at the states at some moments."""

    when: Moments = eqx.field(static=True)

    def rows(self, steps: int, dt: float) -> list[int]:
        return self.when.rows(steps, dt)
