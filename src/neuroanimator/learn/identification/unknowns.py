"""Unknowns of identification besides the starts of windows: parameters, a delay, offsets of sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.learn.identification.measurements import Measurements
from neuroanimator.state.parameters import Parameter

DELAY = "delay"
"""Name of the time by which measurements lag behind the motion."""

MAX_DELAY_STEPS = 2
"""Maximum delay in the search [super steps]."""

OFFSET_RANGE = 0.5
"""Maximum offset in the search, as a share of the range of the measurements."""

INSIDE = 1e-6
"""Margin within its range that a parameter keeps, as a share of it: at the very end an emulator's inputs are clipped."""


@dataclass(frozen=True)
class Unknowns:
    """The unknowns shared by all windows, in this order: parameters, the delay if requested, offsets if requested."""

    parameters: tuple[Parameter, ...]
    has_delay: bool
    offsets: tuple[int, ...]
    """State entries whose measurements have an unknown offset."""
    low: Float[np.ndarray, " G"]
    high: Float[np.ndarray, " G"]
    """Upper bound of each in the search, slightly inside its range, as is the lower."""
    nominal: Float[np.ndarray, " G"]
    names: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def ends(self) -> list[tuple[float, float]]:
        """Minimum and maximum value of each, as users gave them."""
        ends = [(parameter.low, parameter.high) for parameter in self.parameters]
        others = slice(len(ends), None)
        return ends + list(zip(self.low[others].tolist(), self.high[others].tolist(), strict=True))

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.names)

    @property
    def spread(self) -> Float[np.ndarray, " G"]:
        """Standard deviation of each unknown from its range alone."""
        return (self.high - self.low) / np.sqrt(12)


def unknowns_of(
    emulator: Emulator, measurements: Measurements, *, delay: bool = False, offsets: bool = False
) -> Unknowns:
    """Return the unknowns of `emulator`'s family, with a common delay and offsets of all measured numbers if requested."""
    parameters = emulator.parameters
    margins = [INSIDE * (parameter.high - parameter.low) for parameter in parameters]
    low = [p.low + margin for p, margin in zip(parameters, margins, strict=True)]
    high = [p.high - margin for p, margin in zip(parameters, margins, strict=True)]
    nominal = [parameter.nominal for parameter in parameters]
    names = [parameter.name for parameter in parameters]
    units = [parameter.unit for parameter in parameters]
    if delay:
        low.append(0.0)
        high.append(MAX_DELAY_STEPS * emulator.dt)
        nominal.append(0.0)
        names.append(DELAY)
        units.append("s")
    entries = measurements.entries if offsets else ()
    for entry in entries:
        values = measurements.measured[..., entry]
        widest = OFFSET_RANGE * float(np.nanmax(values) - np.nanmin(values))
        low.append(-widest)
        high.append(widest)
        nominal.append(0.0)
        name, unit = emulator.state.names[entry].rsplit(" ", 1)
        names.append(f"offset of {name}")
        units.append(unit)
    return Unknowns(
        parameters=parameters,
        has_delay=delay,
        offsets=entries,
        low=np.array(low),
        high=np.array(high),
        nominal=np.clip(np.array(nominal), low, high),
        names=tuple(names),
        units=tuple(units),
    )
