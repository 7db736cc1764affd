"""A periodic pattern of controls that moves a system forward, as an animal swims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from neuroanimator.files.numbers import number, numbers
from neuroanimator.state.layout import Bounds

MIN_PERIOD = 1e-6
"""Minimum period [s]: a clock can still be divided by it."""

MAX_PERIOD = 1e6
"""Maximum period in a definition [s]."""

GAIT_SHARE = 0.4
"""Default share of training runs that move by the gait: faster, slower, weaker, steered."""

MAX_AMPLITUDE = 1e6
"""Maximum amplitude, far beyond the full range, which is 1; also of the lags [rad]."""


@dataclass(frozen=True)
class Gait:
    """Controls idle + reach · amplitude · sin(2π t / period - lag), within bounds: muscles that only pull rest in between."""

    period: float
    """Period [s]."""
    amplitudes: tuple[float, ...]
    """Amplitude of each control (C,), 1 for its full range; negative ones move oppositely."""
    lags: tuple[float, ...]
    """Phase lag of each control (C,) [rad]."""
    share: float = GAIT_SHARE
    """Share of training runs that move by it."""

    def controls(
        self, steps: int, dt: float, bounds: Bounds, *, tempo: float = 1.0, strength: float = 1.0
    ) -> np.ndarray:
        """Return the pattern (steps, C), each entry held for `dt` [s]: `tempo` times as fast, `strength` as strong."""
        middles = (np.arange(steps)[:, None] + 0.5) * dt
        phases = 2 * np.pi * tempo / self.period * middles - np.array(self.lags)
        amplitudes = strength * np.array(self.amplitudes)
        pattern = bounds.idle + amplitudes * np.sin(phases) * bounds.reach
        return bounds.clip(pattern)

    def to_json(self) -> list[Any]:
        """Return plain lists, without the share if it is the default."""
        row = [self.period, list(self.amplitudes), list(self.lags)]
        return row if self.share == GAIT_SHARE else [*row, self.share]

    @classmethod
    def from_json(cls, row: Any, controls: int) -> Gait:
        """Return the gait `to_json` wrote; ValueError unless it has that many `controls`."""
        if not isinstance(row, list) or len(row) not in (3, 4):
            raise ValueError("gait: wanted a period, amplitudes and lags, and perhaps a share")
        period = number(row[0], "gait: period", MIN_PERIOD, MAX_PERIOD)
        amplitudes = numbers(row[1], "gait: amplitudes", controls, MAX_AMPLITUDE)
        lags = numbers(row[2], "gait: lags", controls, MAX_AMPLITUDE)
        share = number(row[3], "gait: share", 0.0, 1.0) if len(row) == 4 else GAIT_SHARE
        return cls(period, amplitudes, lags, share)
