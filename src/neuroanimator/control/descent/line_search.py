"""Line search: steps along a direction are tried until one meets the Wolfe conditions, bracketed by those that do not.

The bracketing is that of Lewis and Overton (Mathematical Programming 141, 2013); within it the next step is the
minimum of a parabola, Nocedal and Wright's eq. 3.58.
"""

from __future__ import annotations

import math

SUFFICIENT_FALL = 1e-4
"""Minimum decrease of J as a share of that predicted by its initial slope: Nocedal and Wright's c1."""

FLATTENED = 0.9
"""Maximum slope as a share of the initial one: Nocedal and Wright's c2 for quasi-Newton directions."""

WIDENING = 2.0
"""Growth factor of the step while J still falls steeply."""

MARGIN = 0.1
"""Minimum distance of the next step from either end of the bracket, as a share of it."""


class LineSearch:
    """One search: try `step`, pass its result to `learn`, until `is_met`."""

    def __init__(self, cost: float, slope: float, step: float):
        """`cost` is J at the beginning of the search, `slope` its derivative along the direction, `step` the first step."""
        self.step = step
        self.is_met = False
        self._cost = cost
        self._slope = slope
        self._low = 0.0
        self._low_cost = cost
        self._low_slope = slope
        self._high = math.inf
        self._high_cost = math.inf

    def learn(self, cost: float, slope: float) -> bool:
        """Return whether J falls enough at `step`, where it is `cost` with `slope`; choose the next step if necessary."""
        promised = SUFFICIENT_FALL * self.step * self._slope
        falls = math.isfinite(slope) and cost <= self._cost + promised
        if not falls:
            self._high = self.step
            self._high_cost = cost
        elif slope < FLATTENED * self._slope:
            self._low = self.step
            self._low_cost = cost
            self._low_slope = slope
        else:
            self.is_met = True
            return True
        self.step = self._next_step()
        return falls

    def _next_step(self) -> float:
        if math.isinf(self._high):
            return WIDENING * self._low
        width = self._high - self._low
        bend = self._high_cost - self._low_cost - self._low_slope * width
        share = 0.5
        if math.isfinite(bend) and bend > 0:
            share = -self._low_slope * width / (2 * bend)
        return self._low + width * min(max(share, MARGIN), 1 - MARGIN)
