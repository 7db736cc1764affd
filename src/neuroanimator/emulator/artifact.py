"""The file of an emulator: one safetensors file with everything needed to use it, nothing executable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator.codegen.jax_settings import keep_programs
from neuroanimator.emulator.description import FORMAT, Made, blank, describe
from neuroanimator.emulator.networks.network import prefixed
from neuroanimator.emulator.super_step import SuperStep
from neuroanimator.emulator.tensors import emulator_leaves, emulator_tensors, with_tensors
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import Metadata, Tensors, read_tensors, write_tensors
from neuroanimator.text import printable, quoted

TRIAL_NAME = "trial.emulator.safetensors"
"""Name of a temporary file written before a training."""

MAKER = "neuroanimator train"
"""Command that makes emulators again that are too old to be read."""

MAX_FAULT = 300
"""Maximum number of characters shown of an error."""


def save(emulator: SuperStep, path: Path, provenance: dict[str, Any] | None = None) -> None:
    """Write `emulator`; `provenance` states what it was trained on and how (any JSON)."""
    metadata = describe(emulator)
    metadata["provenance"] = provenance or {}
    write_tensors(path, emulator_tensors(emulator) | shape_tensors(emulator), metadata)


def shape_tensors(emulator: SuperStep) -> Tensors:
    """Return the arrays of a soft body's shapes by their names in files; none of other bodies."""
    shapes = emulator.skeleton.shapes
    return {} if shapes is None else prefixed("shapes", shapes.tensors())


def check_readable(emulator: SuperStep, folder: Path, provenance: dict[str, Any]) -> None:
    """Write `emulator` to a file in `folder`, read it back and remove it, as a check before a training.

    Raises ArgumentError for anything that `load` would refuse, such as a state that is too long.
    """
    trial = folder / TRIAL_NAME
    try:
        save(emulator, trial, provenance)
        load(trial, type(emulator))
    except BadFileError as error:
        raise ArgumentError(
            f"Such an emulator could not be read back once it is trained: {error}"
        ) from error
    finally:
        trial.unlink(missing_ok=True)


def load(path: Path, kind: type[Made]) -> Made:
    """Return the emulator at `path`, of the class `kind`, with every name, text, shape and number checked."""
    return emulator_from(path, *read_tensors(path, "emulator"), kind)


def emulator_from(path: Path, tensors: Tensors, metadata: Metadata, kind: type[Made]) -> Made:
    """Return the emulator whose file at `path` has these contents, checked as `load` does."""
    keep_programs()
    check_format(path, metadata.get("format"), FORMAT, MAKER)
    try:
        weights, shapes = without_shapes(tensors)
        emulator = with_tensors(blank(metadata, kind, shapes), emulator_leaves, weights)
        check_arrays(emulator)
    except FAULTS as error:
        raise BadFileError(
            f"{path} is not a usable emulator: {first_line(error)}. Make it again."
        ) from error
    if emulator.definition:
        # Shipped emulators have none, and the tables of definitions take long to import.
        from neuroanimator.definitions.carried import remember_folder

        remember_folder(emulator.definition, path.parent)
    return emulator


def without_shapes(tensors: Tensors) -> tuple[Tensors, Tensors]:
    """Return (the arrays of an emulator or a policy, those of a soft body's shapes by their own names)."""
    weights = {}
    shapes = {}
    for name, tensor in tensors.items():
        if name.startswith("shapes."):
            shapes[name.removeprefix("shapes.")] = tensor
        else:
            weights[name] = tensor
    return weights, shapes


def check_arrays(emulator: SuperStep) -> None:
    """Refuse weights that make every prediction NaN: empty ranges, division by zero."""
    if not (np.asarray(emulator.domain.low) <= np.asarray(emulator.domain.high)).all():
        raise ValueError("domain: wanted low below high")
    if (np.asarray(emulator.normaliser.plain_scale) <= 0).any():
        raise ValueError("normaliser or modes: wanted scales above 0")
    emulator.encoding.check()
    if emulator.calibration is not None:
        emulator.calibration.check()
    if emulator.validation is not None:
        emulator.validation.check()
    for scale in (emulator.normaliser.change_scale, emulator.normaliser.unit):
        if (np.asarray(scale) >= 0).all():  # zero for entries that never move
            continue
        raise ValueError("normaliser: wanted scales of at least 0")


FAULTS = (
    KeyError,
    TypeError,
    ValueError,
    IndexError,
    ArithmeticError,
    RecursionError,
    AttributeError,
    BadFileError,
)
"""Exceptions that reading a stranger's metadata may raise."""


def check_format(path: Path, found: Any, wanted: int, maker: str) -> None:
    """Refuse a file of another format; the error says whether file or program is the older one, and what makes it again."""
    if isinstance(found, bool) or not isinstance(found, int) or found < 1:
        raise BadFileError(
            f"{path} does not say its format; this version reads {wanted}. Make it again with {maker}."
        )
    if found < wanted:
        raise BadFileError(
            f"{path} is of an older version: format {found}; this one reads {wanted}. Make it again with {maker}."
        )
    if found > wanted:
        raise BadFileError(
            f"{path} is of a newer version: format {quoted(found)}; this one reads {wanted}. Upgrade NeuroAnimator."
        )


def first_line(error: Exception) -> str:
    """Return the message of `error` as one line, with text from the file made harmless to show."""
    if isinstance(error, KeyError):
        return f"it has no {quoted(error.args[0])}"
    text = " ".join(str(error).split())[:MAX_FAULT].rstrip(".")
    return printable(text) or type(error).__name__


def read_metadata(path: Path) -> dict[str, Any]:
    """Return the metadata of the file at `path`."""
    return read_tensors(path, "emulator")[1]
