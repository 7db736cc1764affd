"""Parameters of a family of bodies: fixed in a motion, different from body to body.

They are the last entries of a state, which no motion changes. So all that takes states takes them too: a dataset holds
those of every run, an emulator sees them, and its gradient in a state includes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known
from neuroanimator.state.layout import Slice

ROUNDING = 1e-6
"""Tolerance of a value outside its range, as a share of it: emulators have ranges in single precision."""


@dataclass(frozen=True)
class Parameter:
    """A quantity that varies over a family of bodies."""

    name: str
    unit: str
    low: float
    """Smallest value."""
    high: float
    """Largest value."""
    nominal: float
    """Default value."""

    @property
    def slice(self) -> Slice:
        """Its part of a state."""
        return Slice(self.name, 1, self.unit)

    def at(self, value: float) -> Parameter:
        """Return the parameter fixed to this `value`; ArgumentError if it lies outside the range."""
        number = float(value)
        margin = ROUNDING * (self.high - self.low)
        if not self.low - margin <= number <= self.high + margin:
            raise ArgumentError(
                f"{self.name}: wanted {self.low:g} to {self.high:g} {self.unit}, got {number:g}."
            )
        number = min(max(number, self.low), self.high)
        return replace(self, low=number, high=number, nominal=number)


def nominal_values(parameters: Sequence[Parameter]) -> Float[np.ndarray, " P"]:
    """Return the default of each parameter."""
    return np.array([parameter.nominal for parameter in parameters], float)


def draw_parameters(
    parameters: Sequence[Parameter], rng: np.random.Generator, count: int
) -> Float[np.ndarray, "B P"]:
    """Return `count` random bodies of the family, each parameter uniform over its range."""
    low = [parameter.low for parameter in parameters]
    high = [parameter.high for parameter in parameters]
    return rng.uniform(low, high, (count, len(parameters)))


def fixed_parameters(
    parameters: Sequence[Parameter], values: Mapping[str, float]
) -> tuple[Parameter, ...]:
    """Return the `parameters`, with those named in `values` fixed.

    Raises ArgumentError for a name that is not a parameter, and for a value out of range.
    """
    check_known(values, [parameter.name for parameter in parameters], "parameter")
    fixed = []
    for parameter in parameters:
        if parameter.name in values:
            parameter = parameter.at(values[parameter.name])
        fixed.append(parameter)
    return tuple(fixed)
