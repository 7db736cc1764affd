"""Numbers an emulator cannot hold: too large for single precision, or changing by less than its rounding."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.checks import MAX_MAGNITUDE
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.errors import BadFileError

OTHER_UNIT = "Give it in another unit, written as the unit 1."
"""What to do about a number that is too large or too small."""


def refuse_large(file: str, names: Sequence[str], states: Float[np.ndarray, "N S"]) -> None:
    """Raise BadFileError for a number of the state that is larger than an emulator takes; `names` are with units."""
    largest = np.abs(states).max(axis=0)
    for name, magnitude in zip(names, largest, strict=True):
        if magnitude > MAX_MAGNITUDE:
            raise BadFileError(
                f"{file}: state.{name} comes to {magnitude:.3g}; an emulator takes at most {MAX_MAGNITUDE:g}. {OTHER_UNIT}"
            )


def warn_of_small(names: Sequence[str], changes: Float[np.ndarray, "N S"]) -> Iterator[str]:
    """Yield a line for each number of the state whose `changes` in a super step are taken for none; not if it never changes."""
    deviations = changes.std(axis=0)
    for name, deviation in zip(names, deviations, strict=True):
        if 0 < deviation < MIN_CHANGE:
            yield (
                f"state.{name}: changes by {deviation:.2g} in a super step, and less than {MIN_CHANGE:g} is taken for "
                f"rounding. {OTHER_UNIT}"
            )
