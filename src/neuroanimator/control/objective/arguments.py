"""What users say of a cost, checked: weights, tolerances, directions, axes."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import as_numbers
from neuroanimator.state.pose import read_pose
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import System


def as_weight(weight: float) -> Float[AnyArray, ""]:
    """Return an array: another weight needs no other program."""
    return as_parameter(weight)


def checked_structure(system: System) -> Structure:
    """Return the structure of `system`; ArgumentError where a state says nothing of a position."""
    read_pose(system.structure, system.rest)
    return system.structure


def checked_axes(names: str) -> tuple[int, ...]:
    if not names or any(name not in "xyz" for name in names) or len(set(names)) != len(names):
        raise ArgumentError(f"axes: wanted some of x, y, z, such as 'xy', came '{names}'.")
    return tuple("xyz".index(name) for name in names)


def checked_numbers(
    label: str, values: ArrayLike, size: int | None, *, rows: bool = False
) -> Float[np.ndarray, " ..."]:
    """Return `values` (`size`,), or rows of them; ArgumentError unless all are finite and there is at least one."""
    array = as_numbers(values, label)
    axes = 2 if rows else 1
    has_size = size is None or array.shape[-1:] == (size,)
    if array.ndim != axes or not array.size or not has_size or not np.isfinite(array).all():
        numbers = "number" if size == 1 else "numbers"
        wanted = f"{size or 'some'} finite {numbers}"
        if rows:
            wanted = f"rows of {wanted}"
        raise ArgumentError(f"{label}: wanted {wanted}, came {array.tolist()}.")
    return as_parameter(array)


def checked_number(label: str, value: float) -> Float[np.ndarray, " ..."]:
    return checked_numbers(label, [value], 1).reshape(())


def positive(label: str, value: float) -> Float[np.ndarray, " ..."]:
    if not 0 < value < math.inf:
        raise ArgumentError(f"{label}: wanted a finite number above 0, came {value:g}.")
    return as_parameter(value)


def unit_vector(label: str, direction: ArrayLike) -> Float[np.ndarray, " ..."]:
    vector = checked_numbers(label, direction, 3)
    length = float(np.linalg.norm(vector))
    if length == 0:
        raise ArgumentError(f"{label}: wanted a direction, came zeros.")
    return vector / length
