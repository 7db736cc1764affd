"""Unknowns of identification besides the starts of windows: parameters, a delay, offsets of sensors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.learn.identification.measurements import Measurements
from neuroanimator.state.parameters import Parameter, nominal_values

DELAY = "delay"
"""Name of the time by which measurements lag behind the motion."""

MAX_DELAY_STEPS = 2
"""Maximum delay in the search [super steps]."""

OFFSET_RANGE = 0.5
"""Maximum offset in the search, as a share of the range of the measurements."""

INSIDE = 1e-6
"""Margin within its range that an unknown keeps, as a share of it: at the very end an emulator's inputs are clipped."""


@dataclass(frozen=True)
class Unknowns:
    """The unknowns shared by all windows, in this order: parameters, the delay if requested, offsets if requested."""

    each: tuple[Parameter, ...]
    """Name and range of each, as users gave them; a delay and offsets are described as parameters are."""
    parameters: int
    """Number of parameters of the body among them."""
    has_delay: bool
    offsets: tuple[int, ...]
    """State entries whose measurements have an unknown offset."""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each."""
        return tuple(unknown.name for unknown in self.each)

    @cached_property
    def low(self) -> Float[np.ndarray, " G"]:
        """Lower bound of each in the search, slightly inside its range."""
        return np.array([(1 - INSIDE) * one.low + INSIDE * one.high for one in self.each])

    @cached_property
    def high(self) -> Float[np.ndarray, " G"]:
        """Upper bound of each in the search, slightly inside its range."""
        return np.array([(1 - INSIDE) * one.high + INSIDE * one.low for one in self.each])

    @cached_property
    def nominal(self) -> Float[np.ndarray, " G"]:
        """Default of each, within these bounds."""
        return np.clip(nominal_values(self.each), self.low, self.high)

    @property
    def spread(self) -> Float[np.ndarray, " G"]:
        """Standard deviation of each unknown from its range alone."""
        return (self.high - self.low) / np.sqrt(12)


def unknowns_of(
    emulator: Emulator, measurements: Measurements, *, delay: bool = False, offsets: bool = False
) -> Unknowns:
    """Return the unknowns of `emulator`'s family, with a common delay and offsets of all measured numbers if requested."""
    each = [*emulator.parameters]
    if delay:
        each.append(Parameter(DELAY, "s", 0.0, MAX_DELAY_STEPS * emulator.dt, 0.0))
    entries = measurements.entries if offsets else ()
    for entry in entries:
        values = measurements.measured[..., entry]
        widest = OFFSET_RANGE * float(np.nanmax(values) - np.nanmin(values))
        name, unit = emulator.state.names[entry].rsplit(" ", 1)
        each.append(Parameter(f"offset of {name}", unit, -widest, widest, 0.0))
    return Unknowns(tuple(each), len(emulator.parameters), delay, entries)
