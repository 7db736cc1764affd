"""One policy, one safetensors file: its emulator and its network, what commands mean, nothing executable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax

from neuroanimator.control.policies.policy import COMMAND, Policy, fresh_policy
from neuroanimator.emulator.artifact import (
    FAULTS,
    blank,
    check_format,
    describe,
    first_line,
    tensors_of,
    with_tensors,
)
from neuroanimator.emulator.artifact import FORMAT as EMULATOR_FORMAT
from neuroanimator.emulator.networks import MAX_LAYER
from neuroanimator.errors import BadFileError
from neuroanimator.parsing.numbers import listed, whole
from neuroanimator.state.layout import Bounds
from neuroanimator.storage.files import digest, read_tensors, write_tensors

FORMAT = 2
"""Raised whenever an older reader would misunderstand a file."""


def save_policy(policy: Policy, path: Path, provenance: dict[str, Any] | None = None) -> None:
    """Write `policy`; `provenance` says how it was trained (any JSON)."""
    write_tensors(
        path, tensors_of(policy), {**describe_policy(policy), "provenance": provenance or {}}
    )


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
    """Return the policy at `path`, every name, text, shape and number checked."""
    tensors, metadata = read_tensors(path, "policy")
    check_format(path, metadata.get("format"), FORMAT)
    carried = metadata.get("emulator")
    check_format(
        path, carried.get("format") if isinstance(carried, dict) else None, EMULATOR_FORMAT
    )
    try:
        policy = with_tensors(jax.eval_shape(lambda: _blank(metadata)), tensors)
        if digest(tensors_of(policy.emulator)) != metadata["emulator_sha256"]:
            raise ValueError("its emulator is another than it was trained through")
        return policy
    except FAULTS as error:
        raise BadFileError(
            f"{path} is not a usable policy: {first_line(error)}. Make it again."
        ) from error


def _blank(metadata: dict[str, Any]) -> Policy:
    """Return a policy of the described structure with zeros or random numbers for weights."""
    if metadata["command"] != COMMAND.to_json():
        raise ValueError("commands of another meaning")
    ranges = Bounds.from_json(metadata["ranges"], COMMAND.size, "ranges")
    for low, high in zip(ranges.low, ranges.high, strict=True):
        if not low < high:
            raise ValueError("ranges: wanted low below high for every command")
    widths = listed(
        metadata["widths"], "widths", lambda width, what: whole(width, what, 1, MAX_LAYER)
    )
    return fresh_policy(blank(metadata["emulator"]), ranges, widths)
