"""One-step errors number by number, each in its own unit and beside its usual change; and their distribution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.learn.evaluation.accuracy import root_mean_square
from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.state.layout import entry_names, entry_units
from neuroanimator.state.segments import place_segments
from neuroanimator.systems.system import System
from neuroanimator.text import short_number

BINS = 24
"""Number of bars of the histogram of errors."""

SMALLEST = 1e-7
"""Error below which all are counted in the first bar: float32 resolves no smaller ones."""

AXES = ("x", "y", "z")
"""Axes about which an orientation's error is given."""


@dataclass(frozen=True)
class ComponentError:
    """The one-step error of one number of the state, or of an orientation about one axis."""

    name: str
    unit: str
    error: float
    """Root mean square, in `unit`."""
    worst: float
    """Largest magnitude, in `unit`."""
    change: float
    """Standard deviation of its change in a super step, in `unit`."""
    relative: float | None
    """`error` over `change`; None for what never moves."""


@dataclass(frozen=True)
class ErrorSpread:
    """Distribution of the one-step errors of single super steps, in standard deviations of the change."""

    mean: float
    median: float
    high: float
    """Quantile 0.95 of the errors."""
    worst: float
    """Largest error; infinite if one is not finite."""
    edges: Float[np.ndarray, " B1"]
    """Ends of the histogram's bars, in a geometric sequence."""
    counts: Int[np.ndarray, " B"]
    """Number of super steps in each bar; they add up to all."""

    def __str__(self) -> str:
        """Return the quantiles as a sentence."""
        median, high, worst = map(short_number, (self.median, self.high, self.worst))
        return (
            f"one step is off by less than {median} in half of all super steps, than {high} in 95 %, and by {worst} in the "
            "worst [standard deviations of the change]"
        )


def component_errors(test: HeldOut, errors: Float[np.ndarray, "N V"]) -> tuple[ComponentError, ...]:
    """Return the summary of `errors` (N, V) [units of the state], number by number."""
    sound = errors[np.isfinite(errors).all(axis=1)]
    rms = root_mean_square(sound) if len(sound) else np.full(errors.shape[1], np.inf)
    worst = np.abs(errors).max(axis=0, initial=0)
    names = change_names(test.system)
    found = []
    for number, (name, unit) in enumerate(names):
        change = float(test.change_scale[number])
        error = float(rms[number])
        relative = error / change if test.moves[number] else None
        found.append(ComponentError(name, unit, error, float(worst[number]), change, relative))
    return tuple(found)


def change_names(system: System) -> list[tuple[str, str]]:
    """Return name and unit of each number that describes a change of the state.

    They are those of the state's entries, except for an orientation: it turns about three axes.
    """
    names = entry_names(system.state)
    units = entry_units(system.state)
    if not system.structure.segments:
        return list(zip(names, units, strict=True))
    found = []
    for placed in place_segments(system.structure.segments):
        size = placed.segment.change_size
        entries = placed.indices
        if size == len(entries):
            found += [(names[entry], units[entry]) for entry in entries]
        elif size:
            part = names[entries.start].rpartition("[")[0]
            found += [(f"{part} about {axis}", "rad") for axis in AXES[:size]]
    return found


def error_spread(errors: Float[np.ndarray, " N"]) -> ErrorSpread:
    """Return the distribution of `errors` (N,), none below zero; non-finite ones count as infinite."""
    errors = np.where(np.isfinite(errors), errors, np.inf)
    sound = errors[np.isfinite(errors)]
    least = max(float(sound.min(initial=1.0)), SMALLEST)
    most = max(float(sound.max(initial=0.0)), 2 * least)
    edges = np.geomspace(least, most, BINS + 1)
    counts, _ = np.histogram(np.clip(errors, edges[0], edges[-1]), edges)
    with np.errstate(invalid="ignore"):  # halfway between two infinite ones
        median, high = np.nan_to_num(np.quantile(errors, [0.5, 0.95]), nan=np.inf, posinf=np.inf)
    return ErrorSpread(
        mean=float(errors.mean()),
        median=float(median),
        high=float(high),
        worst=float(errors.max()),
        edges=edges,
        counts=counts,
    )


def by_relative_error(components: Sequence[ComponentError]) -> list[ComponentError]:
    """Return the components that move, the worst first."""
    moving = [component for component in components if component.relative is not None]
    return sorted(moving, key=lambda component: -(component.relative or 0.0))
