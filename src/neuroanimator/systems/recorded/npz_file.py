"""Recordings as NumPy's NPZ."""

from __future__ import annotations

import numpy as np

from neuroanimator.errors import BadFileError
from neuroanimator.parsing.npz_archive import parse_npz
from neuroanimator.systems.recorded.columns import (
    MAX_MAGNITUDE,
    Samples,
    name_and_unit,
    refuse_columns,
)

NEEDED = ("time", "states", "controls", "state_names", "control_names")


def read_npz(content: bytes, name: str) -> Samples:
    """Return the samples in an NPZ file; BadFileError names the array, the row and the fix."""
    arrays = _arrays(content, name)
    time, states, controls = (
        _numbers(arrays[key], key, name) for key in ("time", "states", "controls")
    )
    count = time.size
    run = arrays.get("run", np.zeros(count, int))
    shapes = {
        "time": time.ndim == 1,
        "states": states.ndim == 2,
        "controls": controls.ndim == 2,
        "run": run.ndim == 1,
    }
    for key, array in (("time", time), ("states", states), ("controls", controls), ("run", run)):
        if not shapes[key] or len(array) != count:
            raise BadFileError(
                f"{name}: {key} has shape {array.shape}; wanted one row per time, {count} in all."
            )
    named = [_names(arrays[f"{key}_names"], key, name) for key in ("state", "control")]
    refuse_columns(name, *named)
    for key, array, names in (("state", states, named[0]), ("control", controls, named[1])):
        if array.shape[1] != len(names):
            raise BadFileError(
                f"{name}: {key}_names lists {len(names)} names for {array.shape[1]} columns. Name each."
            )
    return Samples(run, time, states, controls, tuple(named[0]), tuple(named[1]))


def _arrays(content: bytes, name: str) -> dict[str, np.ndarray]:
    try:
        arrays = parse_npz(content, (*NEEDED, "run"))
    except ValueError as error:
        raise BadFileError(
            f"{name} is not a usable NPZ file: {error}. Save plain arrays with numpy.savez."
        ) from error
    for key in NEEDED:
        if key not in arrays:
            raise BadFileError(
                f"{name}: no array '{key}'. Wanted: {', '.join(NEEDED)}, and perhaps run."
            )
    return arrays


def _numbers(array: np.ndarray, key: str, name: str) -> np.ndarray:
    if array.dtype.kind not in "fiu":
        raise BadFileError(f"{name}: {key} holds {array.dtype}; wanted numbers.")
    with np.errstate(over="ignore"):  # of long doubles; infinite numbers are refused below
        array = array.astype(float, copy=False)
    usable = np.abs(array) < MAX_MAGNITUDE  # false for NaN too
    if not usable.all():
        index = np.argwhere(~usable)[0].tolist()
        column = f", column {index[1]}" if len(index) > 1 else ""
        raise BadFileError(
            f"{name}: {key}, row {index[0] if index else 0}{column}: not a finite number. Fill it in, or cut it out."
        )
    return array


def _names(array: np.ndarray, key: str, name: str) -> list[tuple[str, str]]:
    if array.ndim != 1 or array.dtype.kind != "U":
        raise BadFileError(f"{name}: {key}_names: wanted a list of texts such as 'angle rad'.")
    try:
        texts = array.tolist()
    except (ValueError, SystemError) as error:  # numbers that are no characters
        raise BadFileError(
            f"{name}: {key}_names holds no texts: {error}. Save them again."
        ) from error
    return [name_and_unit(text, f"{name}: {key}_names[{i}]") for i, text in enumerate(texts)]
