"""Angles and orientations in a recording, without jumps that mean nothing: whole turns, and the signs of quaternions.

q and -q are one rotation. Sensors and other programs often keep one number positive, so that all four jump.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from neuroanimator.state.rotation import continuous

ORDERS = ("wxyz", "xyzw", "0123", "1234")
"""The letters or digits by which the names of a quaternion's columns differ, in their usual orders."""

MAX_LENGTH_ERROR = 0.05
"""Maximum deviation of a quaternion's length from 1: files round."""


def entries_in(columns: Sequence[tuple[str, str]], unit: str) -> list[int]:
    """Return the columns in this unit."""
    return [entry for entry, (_, own) in enumerate(columns) if own == unit]


def without_jumps(
    states: Float[np.ndarray, "N S"], angles: Sequence[int]
) -> Float[np.ndarray, "N S"]:
    """Return the states with the entries `angles` [rad] unwrapped across half turns."""
    continuous = states.copy()
    continuous[:, angles] = np.unwrap(states[:, angles], axis=0)
    return continuous


def rotations_in(
    columns: Sequence[tuple[str, str]], states: Float[np.ndarray, "N S"]
) -> list[slice]:
    """Return the entries of each quaternion: four neighbours named alike, plain numbers of length 1 in every row."""
    found: list[slice] = []
    for first in range(len(columns) - 3):
        place = slice(first, first + 4)
        names = [name for name, _ in columns[place]]
        units = {unit for _, unit in columns[place]}
        if units != {"1"} or (found and found[-1].stop > first) or not _are_alike(names):
            continue
        lengths = np.linalg.norm(states[:, place], axis=1)
        if (np.abs(lengths - 1) < MAX_LENGTH_ERROR).all():
            found.append(place)
    return found


def _are_alike(names: Sequence[str]) -> bool:
    """Return whether four names differ only by the letters or digits of a quaternion."""
    for order in ORDERS:
        for begin in (match.start() for match in re.finditer(order[0], names[0].lower())):
            rest = [name[:begin] + name[begin + 1 :] for name in names]
            letters = "".join(name[begin : begin + 1] for name in names).lower()
            if letters == order and len(set(rest)) == 1:
                return True
    return False


def with_one_sign(
    runs: Sequence[Float[np.ndarray, "_ S"]], rotations: Sequence[slice]
) -> list[Float[np.ndarray, "_ S"]]:
    """Return the runs with quaternions that do not jump, and begin on the side of the first run's beginning."""
    steady = []
    for states in runs:
        turned = states.copy()
        for place in rotations:
            turned[:, place] = continuous(states[:, place], runs[0][:1, place])
        steady.append(turned)
    return steady
