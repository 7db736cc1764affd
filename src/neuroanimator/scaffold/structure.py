"""Structure of a state, inferred from trial calls or recordings: angles, entries without an origin, rates of change."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.state.rotation import wrapped

States = Float[np.ndarray, "_ S"]
"""States, one in each row."""

Step = Callable[[States], States]
"""One step of many states, each under its own control."""

TURN = 2 * np.pi
"""A whole turn [rad]."""

SHIFTS = (0.31, -4.7, 53.0)
"""Multiples of the trial states' spread by which an entry is shifted to test whether its value matters."""

TOLERANCE = 1e-6
"""Relative difference within which results are equal: sines of large angles are rounded."""


def turning_entries(step: Step, states: States, units: Sequence[str]) -> Bool[np.ndarray, " S"]:
    """Return which entries are angles that may turn all the way round: one more turn changes nothing else."""
    is_turning = [
        unit == "rad" and _is_same_after(step, states, entry, TURN, units)
        for entry, unit in enumerate(units)
    ]
    return np.array(is_turning)


def placeless_entries(step: Step, states: States, units: Sequence[str]) -> Bool[np.ndarray, " S"]:
    """Return which entries have values that do not matter: shifting them leaves all changes the same."""
    is_placeless = []
    for entry, spread in enumerate(np.maximum(states.std(axis=0), TOLERANCE)):
        shifts = [share * spread for share in SHIFTS]
        if units[entry] == "rad":
            shifts.append(1.0)
        is_same = all(_is_same_after(step, states, entry, shift, units) for shift in shifts)
        is_placeless.append(is_same)
    return np.array(is_placeless)


def _is_same_after(
    step: Step, states: States, entry: int, shift: float, units: Sequence[str]
) -> bool:
    """Return whether shifting an entry shifts that entry after the step, and nothing else, up to whole turns."""
    offset = np.zeros(len(units))
    offset[entry] = shift
    usual = step(states)
    found = step(states + offset)
    if not np.isfinite(found).all():
        return False
    difference = found - usual - offset
    is_angle = np.array(units) == "rad"
    difference[:, is_angle] = wrapped(difference[:, is_angle])
    scale = np.maximum(np.abs(usual).max(axis=0), abs(shift))
    return bool((np.abs(difference) <= TOLERANCE * np.maximum(scale, 1.0)).all())
