"""Recordings as NumPy's NPZ: arrays of times, states, controls, and the names of their columns."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import Tensors
from neuroanimator.files.clock import resolution_of
from neuroanimator.files.npz_archive import parse_npz
from neuroanimator.files.numbers import MAX_MAGNITUDE
from neuroanimator.state.columns import (
    Column,
    Samples,
    Vocabulary,
    columns_of,
    samples_of,
    seconds,
    time_column,
)

TIMES = ("time", "time_s", "time_ms", "time_us", "time_ns")
"""Names of the array of times, by their unit: seconds in the first, unless whole numbers leave that open."""

NEEDED = ("states", "state_names")
"""Names of the other arrays every recording has."""

OPTIONAL = ("controls", "control_names", "run")
"""Names of optional arrays: those of a control, if nothing drives the recorded system, and `run`."""

DIMENSIONS = {"time": 1, "states": 2, "controls": 2, "run": 1}
"""Number of dimensions of each array; the first is the samples."""


def read_npz(content: bytes, name: str, vocabulary: Vocabulary | None = None) -> Samples:
    """Return the samples in an NPZ file; BadFileError names the array, the row and the fix."""
    arrays = _arrays(content, name)
    key = next(key for key in arrays if time_column(key))
    times, clock = _clock_in(arrays[key], key, name)
    count = times.size
    table = {"state": _numbers(arrays["states"], "states", name)}
    unwanted = np.zeros((count, 0))
    table["control"] = _numbers(arrays.get("controls", unwanted), "controls", name)
    run = arrays.get("run", np.zeros(count, int))
    rows = {"time": times, "run": run} | {f"{key}s": array for key, array in table.items()}
    for key, array in rows.items():
        if array.ndim != DIMENSIONS[key] or len(array) != count:
            raise BadFileError(
                f"{name}: {key} has shape {array.shape}; wanted one row per time, {count} in all."
            )
    cells: dict[str, str] = {}
    for vector, array in table.items():
        texts = _texts(arrays.get(f"{vector}_names", np.array([], str)), vector, name)
        if array.shape[1] != len(texts):
            raise BadFileError(
                f"{name}: {vector}_names lists {len(texts)} names for {array.shape[1]} columns. Name each."
            )
        for number, text in enumerate(texts):
            cells[f"{name}: {vector}_names[{number}]"] = f"{vector}.{text}"
    columns = columns_of(cells, vocabulary, name)
    usual = "s" if times.dtype.kind == "f" else ""
    timing = seconds(times, clock, f"{name}: {key}", usual)
    every = np.hstack([table["state"], table["control"]])
    return samples_of(run, timing, resolution_of(times), every, columns)


def _clock_in(times: np.ndarray, key: str, name: str) -> tuple[np.ndarray, Column]:
    """Return times as numbers, and their unit: that of NumPy's own times, or of the array's name."""
    if times.dtype.kind in "mM":
        unit, count = np.datetime_data(times.dtype)
        if np.isnat(times).any():
            raise BadFileError(
                f"{name}: {key} lacks some times. Fill them in, or cut these rows out."
            )
        column = time_column(f"time {unit}")
        if column is None:
            raise BadFileError(f"{name}: {key} holds {times.dtype}; wanted seconds.")
        return times.astype(np.int64), column._replace(factor=count * column.factor)
    column = time_column(key)
    assert column is not None
    _numbers(times, key, name)
    if times.dtype.kind == "u":
        times = times.astype(np.int64)
    return times, column


def _arrays(content: bytes, name: str) -> Tensors:
    try:
        arrays = parse_npz(content, (*TIMES, *NEEDED, *OPTIONAL))
    except ValueError as error:
        raise BadFileError(
            f"{name} is not a usable NPZ file: {error}. Save plain arrays with numpy.savez."
        ) from error
    for choices in (TIMES, *((key,) for key in NEEDED)):
        if not any(key in arrays for key in choices):
            raise BadFileError(
                f"{name}: no array '{choices[0]}'. Wanted: time, {', '.join(NEEDED)}, and perhaps {', '.join(OPTIONAL)}."
            )
    return arrays


def _numbers(array: np.ndarray, key: str, name: str) -> Float[np.ndarray, " ..."]:
    """Return an array of any shape in double precision; BadFileError if one of its numbers is not finite."""
    if array.dtype.kind not in "fiu":
        raise BadFileError(f"{name}: {key} holds {array.dtype}; wanted numbers.")
    with np.errstate(over="ignore"):  # large long doubles; infinite numbers are refused below
        array = array.astype(float, copy=False)
    usable = np.abs(array) < MAX_MAGNITUDE  # False for NaN
    if not usable.all():
        row, *inside = np.argwhere(~usable)[0].tolist() or [0]
        column = "".join(f", column {number}" for number in inside)
        raise BadFileError(
            f"{name}: {key}, row {row}{column}: not a finite number. Fill it in, or cut it out."
        )
    return array


def _texts(array: np.ndarray, key: str, name: str) -> list[str]:
    if array.ndim != 1 or array.dtype.kind != "U":
        raise BadFileError(f"{name}: {key}_names: wanted a list of texts such as 'angle rad'.")
    try:
        return array.tolist()
    except (ValueError, SystemError) as error:  # numbers that are not characters
        raise BadFileError(
            f"{name}: {key}_names holds no texts: {error}. Save them again."
        ) from error
