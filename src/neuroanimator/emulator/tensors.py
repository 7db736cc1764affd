"""The arrays of an emulator by their names in files, which are permanent (`docs/format.md`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from neuroanimator.emulator.arrays import array_fields
from neuroanimator.emulator.networks.network import prefixed
from neuroanimator.emulator.super_step import SuperStep
from neuroanimator.files.atomic import Tensors
from neuroanimator.text import quoted


def emulator_leaves(emulator: SuperStep) -> dict[str, Any]:
    """Return every array of `emulator` by its name in files."""
    leaves = {
        "features.angles": emulator.features.angles,
        "normaliser.feature_mean": emulator.normaliser.plain_mean,
        "normaliser.feature_scale": emulator.normaliser.plain_scale,
        "normaliser.change_mean": emulator.normaliser.change_mean,
        "normaliser.change_scale": emulator.normaliser.change_scale,
        "normaliser.error_unit": emulator.normaliser.unit,
        **prefixed("network", emulator.network.leaves()),
    }
    parts = {
        "domain": emulator.domain,
        "modes": emulator.encoding,
        "trust": emulator.meter,
        "errors": emulator.calibration,
        "validation": emulator.validation,
    }
    for name, part in parts.items():
        if part is not None:
            leaves |= prefixed(name, array_fields(part))
    return leaves


def emulator_tensors(emulator: SuperStep) -> Tensors:
    """Return every array of `emulator` by its name in files, as NumPy arrays."""
    return to_numpy(emulator_leaves(emulator))


def to_numpy(leaves: Mapping[str, Any]) -> Tensors:
    """Return `leaves` as NumPy arrays."""
    return {name: np.asarray(leaf) for name, leaf in leaves.items()}


def with_tensors(
    tree: Any, leaves_of: Callable[[Any], dict[str, Any]], tensors: Mapping[str, np.ndarray]
) -> Any:
    """Return `tree` with its arrays, named by `leaves_of`, replaced by `tensors`.

    Raises ValueError unless names, shapes and kinds of number are exactly the same.
    """
    leaves_by_name = leaves_of(tree)
    if len(leaves_by_name) != len(jax.tree.leaves(tree)):
        raise ValueError("not every array has a name in files")
    arrays = checked_arrays(leaves_by_name, tensors)
    places = [id(leaf) for leaf in leaves_by_name.values()]
    array_at = dict(zip(places, arrays, strict=True))
    return jax.tree.map(lambda leaf: array_at[id(leaf)], tree)


def checked_arrays(
    leaves: Mapping[str, Any], tensors: Mapping[str, np.ndarray]
) -> list[np.ndarray]:
    """Return `tensors` in the order and the dtypes of `leaves`.

    Raises ValueError unless names, shapes and kinds of number are exactly those of `leaves`.
    """
    if set(leaves) != set(tensors):
        wrong = sorted(set(leaves) ^ set(tensors))[0]
        raise ValueError(f"tensor {quoted(wrong)} is missing or not expected")
    for name, leaf in leaves.items():
        _check_tensor(name, tensors[name], leaf)
    return [tensors[name].astype(leaf.dtype, copy=False) for name, leaf in leaves.items()]


def _check_tensor(name: str, tensor: np.ndarray, leaf: Any) -> None:
    """Refuse a tensor of another shape or kind of number than `leaf`, or too large for float32."""
    if tensor.shape != leaf.shape:
        raise ValueError(f"tensor '{name}' has shape {tensor.shape}; wanted {leaf.shape}")
    if tensor.dtype.kind != leaf.dtype.kind:
        raise ValueError(f"tensor '{name}' holds {tensor.dtype}; wanted {leaf.dtype}")
    if leaf.dtype.kind == "f" and (np.abs(tensor) > np.finfo(np.float32).max).any():
        raise ValueError(f"tensor '{name}' holds a number too large for float32")
