"""One policy, one safetensors file: its emulator and its network, what commands mean, nothing executable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import numpy as np

from neuroanimator.control.policies.policy import COMMAND, Policy, fresh_policy
from neuroanimator.emulator.artifact import FORMAT as EMULATOR_FORMAT
from neuroanimator.emulator.artifact import WIDEST_LAYER, blank, describe, tensors_of, with_tensors
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files import digest, read_tensors, write_tensors
from neuroanimator.systems.layout import Bounds

FORMAT = 1
"""Raised whenever an older reader would misunderstand a file."""


def save_policy(policy: Policy, path: Path, provenance: dict[str, Any] | None = None) -> None:
    """Write `policy`; `provenance` says how it was trained (any JSON)."""
    write_tensors(path, tensors_of(policy), {**describe_policy(policy), "provenance": provenance or {}})


def describe_policy(policy: Policy) -> dict[str, Any]:
    """Return the metadata that, with the tensors, makes up the policy."""
    return {
        "kind": "policy",
        "format": FORMAT,
        "emulator": describe(policy.emulator),
        "emulator_sha256": digest(tensors_of(policy.emulator)),
        "command": COMMAND.to_json(),
        "ranges": [list(policy.ranges.low), list(policy.ranges.high)],
        "widths": list(policy.network.widths),
    }


def load_policy(path: Path) -> Policy:
    """Return the policy at `path`, every name, shape and number checked."""
    tensors, metadata = read_tensors(path, "policy")
    if metadata.get("format") != FORMAT:
        raise BadFileError(
            f"{path} has format {metadata.get('format')!r}; this version reads {FORMAT}. Upgrade NeuroAnimator."
        )
    try:
        policy = with_tensors(jax.eval_shape(lambda: _blank(metadata)), tensors)
        if digest(tensors_of(policy.emulator)) != metadata["emulator_sha256"]:
            raise ValueError("its emulator is another than it was trained through")
        return policy
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, ArgumentError) as error:
        raise BadFileError(f"{path} is not a usable policy: {first_line(error)}. Train it again.") from error


def first_line(error: Exception) -> str:
    """Return the start of what `error` says."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


def _blank(metadata: dict[str, Any]) -> Policy:
    """Return a policy of the described structure with zeros or random numbers for weights."""
    if metadata["emulator"]["format"] != EMULATOR_FORMAT:
        raise ValueError("its emulator is of another version")
    if metadata["command"] != COMMAND.to_json():
        raise ValueError("commands of another meaning")
    ranges = Bounds(*(tuple(float(value) for value in side) for side in metadata["ranges"]))
    widths = tuple(int(width) for width in metadata["widths"])
    if max(widths) > WIDEST_LAYER or min(widths) < 1:
        raise ValueError("sizes out of range")
    if len(ranges.low) != COMMAND.size or not (np.array(ranges.low) < np.array(ranges.high)).all():
        raise ValueError("ranges: wanted low below high for every command")
    return fresh_policy(blank(metadata["emulator"]), ranges, widths)
