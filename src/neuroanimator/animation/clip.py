"""Timed poses at the display rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroanimator.animation.interpolate import INTERPOLATIONS
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError

FASTEST_RATE = 1000.0
"""Highest display rate accepted [1/s]; no display and no engine asks for more."""


@dataclass(frozen=True)
class Clip:
    """A motion ready to draw or export."""

    name: str
    skeleton: Skeleton
    times: np.ndarray
    """(F,) [s], evenly spaced."""
    states: np.ndarray
    """(F, S) in the system's own layout."""
    definition: str = ""
    """Of a user's own system; see `System.definition`."""
    source: str = ""
    """What made the motion, as exports say it: 'emulator' or 'physics'; empty if not known."""

    def __repr__(self) -> str:
        return f'Clip("{self.name}", {len(self.times)} frames, {self.times[-1]:.2f} s)'

    @property
    def rate(self) -> float:
        """Frames a second."""
        return (len(self.times) - 1) / float(self.times[-1])


def make_clip(
    emulator: Emulator,
    states: np.ndarray,
    *,
    rate: float = 30.0,
    interpolation: str = "hermite",
    source: str = "",
) -> Clip:
    """Return the clip of a trajectory (T+1, S) at `rate` frames a second; `source` says what made it."""
    if interpolation not in INTERPOLATIONS:
        raise ArgumentError(
            f"No interpolation called '{interpolation}'. Interpolations: {', '.join(sorted(INTERPOLATIONS))}."
        )
    spec = emulator.spec
    states = spec.state.check(states, "state")
    if not 0 < rate <= FASTEST_RATE:
        raise ArgumentError(
            f"rate: wanted between 0 and {FASTEST_RATE:g} frames a second, came {rate}."
        )
    duration = (len(states) - 1) * spec.dt
    frames = max(1, int(duration * rate + 1e-6))
    times = np.arange(frames + 1) / rate
    times = times[times <= duration + 1e-9] if frames > 1 else np.array([0.0, duration])
    orientations = emulator.state_structure.orientations
    between = INTERPOLATIONS[interpolation](states, spec.dt, times, spec.rates, orientations)
    return Clip(spec.system, spec.skeleton, times, between, spec.definition, source)
