"""Recordings as NumPy's NPZ: arrays of times, states, controls, and the names of their columns."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import BadFileError
from neuroanimator.files.npz_archive import parse_npz
from neuroanimator.systems.recorded.columns import (
    MAX_MAGNITUDE,
    Samples,
    name_and_unit,
    refuse_columns,
)

NEEDED = ("time", "states", "state_names")
"""Names of the arrays every recording has."""

OPTIONAL = ("controls", "control_names", "run")
"""Names of optional arrays: those of a control, if nothing drives the recorded system, and `run`."""

DIMENSIONS = {"time": 1, "states": 2, "controls": 2, "run": 1}
"""Number of dimensions of each array; the first is the samples."""


def read_npz(content: bytes, name: str) -> Samples:
    """Return the samples in an NPZ file; BadFileError names the array, the row and the fix."""
    arrays = _arrays(content, name)
    time = _numbers(arrays["time"], "time", name)
    states = _numbers(arrays["states"], "states", name)
    count = time.size
    controls = _numbers(arrays.get("controls", np.zeros((count, 0))), "controls", name)
    run = arrays.get("run", np.zeros(count, int))
    rows = {"time": time, "states": states, "controls": controls, "run": run}
    for key, array in rows.items():
        if array.ndim != DIMENSIONS[key] or len(array) != count:
            raise BadFileError(
                f"{name}: {key} has shape {array.shape}; wanted one row per time, {count} in all."
            )
    state = _names(arrays["state_names"], "state", name)
    control = _names(arrays.get("control_names", np.array([], str)), "control", name)
    refuse_columns(name, state, control)
    _check_count(states, state, "state", name)
    _check_count(controls, control, "control", name)
    return Samples(run, time, states, controls, tuple(state), tuple(control))


def _check_count(
    array: Float[np.ndarray, "N D"], names: list[tuple[str, str]], key: str, name: str
) -> None:
    if array.shape[1] != len(names):
        raise BadFileError(
            f"{name}: {key}_names lists {len(names)} names for {array.shape[1]} columns. Name each."
        )


def _arrays(content: bytes, name: str) -> dict[str, np.ndarray]:
    try:
        arrays = parse_npz(content, (*NEEDED, *OPTIONAL))
    except ValueError as error:
        raise BadFileError(
            f"{name} is not a usable NPZ file: {error}. Save plain arrays with numpy.savez."
        ) from error
    for key in NEEDED:
        if key not in arrays:
            raise BadFileError(
                f"{name}: no array '{key}'. Wanted: {', '.join(NEEDED)}, and perhaps {', '.join(OPTIONAL)}."
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
        index = np.argwhere(~usable)[0].tolist()
        row = 0
        column = ""
        if index:
            row = index[0]
        if len(index) > 1:
            column = f", column {index[1]}"
        raise BadFileError(
            f"{name}: {key}, row {row}{column}: not a finite number. Fill it in, or cut it out."
        )
    return array


def _names(array: np.ndarray, key: str, name: str) -> list[tuple[str, str]]:
    if array.ndim != 1 or array.dtype.kind != "U":
        raise BadFileError(f"{name}: {key}_names: wanted a list of texts such as 'angle rad'.")
    try:
        texts = array.tolist()
    except (ValueError, SystemError) as error:  # numbers that are not characters
        raise BadFileError(
            f"{name}: {key}_names holds no texts: {error}. Save them again."
        ) from error
    return [name_and_unit(text, f"{name}: {key}_names[{i}]") for i, text in enumerate(texts)]
