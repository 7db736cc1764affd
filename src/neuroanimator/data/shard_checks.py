"""What the files of a dataset must hold: a dataset may be a stranger's, and its hashes then prove nothing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from neuroanimator.errors import BadFileError


class Wanted(NamedTuple):
    """One tensor as it must be."""

    dtype: type[np.generic]
    shape: tuple[int | None, ...]
    """None where any length will do, the same one throughout the file."""


def largest_size(wanted: dict[str, Wanted], rows: int) -> int:
    """Return how many bytes the tensors take if the open length is `rows`."""
    counts = [
        math.prod(rows if length is None else length for length in shape)
        for _, shape in wanted.values()
    ]
    return sum(
        count * np.dtype(dtype).itemsize
        for count, (dtype, _) in zip(counts, wanted.values(), strict=True)
    )


def check_tensors(path: Path, tensors: dict[str, np.ndarray], wanted: dict[str, Wanted]) -> int:
    """Return the length that was left open; BadFileError unless names, types and shapes are as `wanted`."""
    if set(tensors) != set(wanted):
        refuse(path, f"tensors {_listed(tensors)}; wanted {_listed(wanted)}")
    open_length: int | None = None
    for name, (dtype, shape) in wanted.items():
        array = tensors[name]
        if array.dtype != dtype:
            refuse(path, f"tensor '{name}' holds {array.dtype}; wanted {np.dtype(dtype)}")
        open_length = array.shape[0] if open_length is None and array.ndim else open_length
        filled = tuple(open_length if length is None else length for length in shape)
        if array.shape != filled:
            refuse(path, f"tensor '{name}' has shape {array.shape}; wanted {filled}")
    return open_length or 0


def check_range(path: Path, name: str, array: np.ndarray, least: int, largest: int) -> None:
    """Refuse whole numbers outside `least` to `largest`: negative ones would count from the end."""
    if array.size and (array.min() < least or array.max() > largest):
        refuse(
            path,
            f"tensor '{name}' holds {array.min()} to {array.max()}; wanted {least} to {largest}",
        )


def whole_number(path: Path, metadata: dict[str, Any], key: str, largest: int) -> int:
    """Return what `metadata` says under `key`; BadFileError unless it is a whole number from 0 to `largest`."""
    value = metadata.get(key)
    if type(value) is not int or not 0 <= value <= largest:
        refuse(path, f"{key} is {str(value)[:40]!r}; wanted a whole number from 0 to {largest:,}")
    return value


def refuse(path: Path, fault: str) -> NoReturn:
    """Raise BadFileError: `path: fault.`, and what to do."""
    raise BadFileError(f"{path}: {fault}. Generate the dataset again.")


def _listed(names: dict[str, Any]) -> str:
    return ", ".join(name[:20] for name in sorted(names)[:8]) or "none"
