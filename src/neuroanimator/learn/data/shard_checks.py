"""Checks of a dataset's files: it may come from a stranger, and its hashes then prove nothing."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, NoReturn

import numpy as np
from jaxtyping import Int

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import Metadata, Tensors
from neuroanimator.files.numbers import whole
from neuroanimator.files.places import Place
from neuroanimator.text import listed

MAX_NAME = 20
"""Maximum length of a tensor's name in an error [characters]; longer ones are cut off."""


class TensorSpec(NamedTuple):
    """The required type and shape of a tensor."""

    dtype: type[np.generic]
    shape: tuple[int | None, ...]
    """None for an open length, which must be the same throughout the file."""

    def filled(self, open_length: int | None) -> tuple[int | None, ...]:
        """Return the shape with `open_length` filled in."""
        return tuple(open_length if length is None else length for length in self.shape)


def largest_size(specs: dict[str, TensorSpec], rows: int) -> int:
    """Return the size of the tensors [bytes] if the open length is `rows`."""
    total = 0
    for spec in specs.values():
        count = math.prod(rows if length is None else length for length in spec.shape)
        total += count * np.dtype(spec.dtype).itemsize
    return total


def check_tensors(path: Place, tensors: Tensors, specs: dict[str, TensorSpec]) -> int:
    """Return the open length; BadFileError unless names, types and shapes are as in `specs`."""
    if set(tensors) != set(specs):
        refuse(path, f"tensors {_listed(tensors)}; wanted {_listed(specs)}")
    open_length: int | None = None
    for name, spec in specs.items():
        array = tensors[name]
        if array.dtype != spec.dtype:
            refuse(path, f"tensor '{name}' holds {array.dtype}; wanted {np.dtype(spec.dtype)}")
        if open_length is None and array.ndim:
            open_length = array.shape[0]
        shape = spec.filled(open_length)
        if array.shape != shape:
            refuse(path, f"tensor '{name}' has shape {array.shape}; wanted {shape}")
    return open_length or 0


def check_range(
    path: Place, name: str, array: Int[np.ndarray, " ..."], minimum: int, maximum: int
) -> None:
    """Refuse whole numbers outside `minimum` to `maximum`: negative ones would count from the end."""
    if array.size and (array.min() < minimum or array.max() > maximum):
        refuse(
            path,
            f"tensor '{name}' holds {array.min()} to {array.max()}; wanted {minimum} to {maximum}",
        )


def whole_number(path: Place, metadata: Metadata, key: str, maximum: int) -> int:
    """Return the value of `key` in `metadata`; BadFileError unless it is a whole number from 0 to `maximum`."""
    try:
        return whole(metadata.get(key), key, 0, maximum)
    except ValueError as error:
        refuse(path, str(error))


def refuse(path: Place, fault: str) -> NoReturn:
    """Raise BadFileError with `path: fault.` and what to do."""
    raise BadFileError(f"{path}: {fault}. Generate the dataset again.")


def _listed(names: dict[str, Any]) -> str:
    return listed(name[:MAX_NAME] for name in sorted(names)) or "none"
