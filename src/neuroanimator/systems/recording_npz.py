"""Recordings as NumPy's NPZ."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np

from neuroanimator.errors import BadFileError
from neuroanimator.systems.given import LARGEST_FILE
from neuroanimator.systems.recording_columns import Samples, name_and_unit, refuse_columns

NEEDED = ("time", "states", "controls", "state_names", "control_names")


def read_npz(content: bytes, name: str) -> Samples:
    """Return the samples in an NPZ file; BadFileError names the array, the row and the fix."""
    arrays = _arrays(content, name)
    time, states, controls = (_numbers(arrays[key], key, name) for key in ("time", "states", "controls"))
    count = len(time)
    run = np.asarray(arrays.get("run", np.zeros(count, int)))
    shapes = {"time": time.ndim == 1, "states": states.ndim == 2, "controls": controls.ndim == 2, "run": run.ndim == 1}
    for key, array in (("time", time), ("states", states), ("controls", controls), ("run", run)):
        if not shapes[key] or len(array) != count:
            raise BadFileError(f"{name}: {key} has shape {array.shape}; wanted one row per time, {count} in all.")
    named = [_names(arrays[f"{key}_names"], key, name) for key in ("state", "control")]
    refuse_columns(name, *named)
    for key, array, names in (("state", states, named[0]), ("control", controls, named[1])):
        if array.shape[1] != len(names):
            raise BadFileError(f"{name}: {key}_names lists {len(names)} names for {array.shape[1]} columns. Name each.")
    return Samples(run, time, states, controls, tuple(named[0]), tuple(named[1]))


def _arrays(content: bytes, name: str) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > LARGEST_FILE:
            raise BadFileError(f"{name}: {size:,} bytes unpacked; wanted at most {LARGEST_FILE:,}. Split it.")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files if key in (*NEEDED, "run")}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, NotImplementedError) as error:
        text = " ".join(str(error).split())[:120]
        raise BadFileError(f"{name} is not a usable NPZ file: {text}. Save plain arrays with numpy.savez.") from error
    for key in NEEDED:
        if key not in arrays:
            raise BadFileError(f"{name}: no array '{key}'. Wanted: {', '.join(NEEDED)}, and perhaps run.")
    return arrays


def _numbers(array: np.ndarray, key: str, name: str) -> np.ndarray:
    if array.dtype.kind not in "fiu":
        raise BadFileError(f"{name}: {key} holds {array.dtype}; wanted numbers.")
    array = array.astype(float)
    if not np.isfinite(array).all():
        place = np.argwhere(~np.isfinite(array))[0].tolist()
        column = f", column {place[1]}" if len(place) > 1 else ""
        raise BadFileError(
            f"{name}: {key}, row {place[0] if place else 0}{column}: not a finite number. Fill it in, or cut it out."
        )
    return array


def _names(array: np.ndarray, key: str, name: str) -> list[tuple[str, str]]:
    if array.ndim != 1 or array.dtype.kind != "U":
        raise BadFileError(f"{name}: {key}_names: wanted a list of texts such as 'angle rad'.")
    return [name_and_unit(str(text), f"{name}: {key}_names[{i}]") for i, text in enumerate(array)]
