"""The file of a policy: one safetensors file with its emulator, its network and what commands mean, nothing executable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from neuroanimator.control.policies.policy import COMMAND, Policy, make_policy
from neuroanimator.emulator.artifact import (
    FAULTS,
    check_format,
    first_line,
)
from neuroanimator.emulator.description import FORMAT as EMULATOR_FORMAT
from neuroanimator.emulator.description import blank, describe
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks import MAX_LAYER
from neuroanimator.emulator.networks.network import prefixed
from neuroanimator.emulator.tensors import (
    emulator_leaves,
    emulator_tensors,
    to_numpy,
    with_tensors,
)
from neuroanimator.errors import BadFileError
from neuroanimator.parsing.numbers import listed, whole
from neuroanimator.state.layout import Bounds
from neuroanimator.storage.files import digest, read_tensors, write_tensors
from neuroanimator.zoo import find_policy

FORMAT = 2
"""The version of the file format, raised whenever an older reader would misunderstand a file."""

MAKER = "train_policy"
"""Command that trains policies anew that are too old to be read."""


def save_policy(policy: Policy, path: Path, provenance: dict[str, Any] | None = None) -> None:
    """Write `policy` to `path`; `provenance` says how it was trained (any JSON)."""
    metadata = describe_policy(policy) | {"provenance": provenance or {}}
    write_tensors(path, to_numpy(policy_leaves(policy)), metadata)


def policy_leaves(policy: Policy) -> dict[str, Any]:
    """Return every array of `policy` by its name in files."""
    emulator = prefixed("emulator", emulator_leaves(policy.emulator))
    return emulator | prefixed("network", policy.network.leaves())


def describe_policy(policy: Policy) -> dict[str, Any]:
    """Return the metadata that, with the tensors, makes up the policy."""
    return {
        "kind": "policy",
        "format": FORMAT,
        "emulator": describe(policy.emulator),
        "emulator_sha256": digest(emulator_tensors(policy.emulator)),
        "command": COMMAND.to_json(),
        "ranges": [list(policy.ranges.low), list(policy.ranges.high)],
        "widths": list(policy.network.widths),
    }


def load_policy(name: str | Path) -> Policy:
    """Return the policy in the file `name`, or the shipped one of the system called `name`, such as `fish`.

    Every name, text, shape and number in the file is checked. Raises BadFileError, which says what is wrong with the
    file, or which policies ship.
    """
    path = find_policy(str(name))
    tensors, metadata = read_tensors(path, "policy")
    check_format(path, metadata.get("format"), FORMAT, MAKER)
    emulator = metadata.get("emulator")
    emulator_format = emulator.get("format") if isinstance(emulator, dict) else None
    check_format(path, emulator_format, EMULATOR_FORMAT, MAKER)
    try:
        policy = with_tensors(blank_policy(metadata), policy_leaves, tensors)
        if digest(emulator_tensors(policy.emulator)) != metadata["emulator_sha256"]:
            raise ValueError("its emulator is another than it was trained through")
        return policy
    except FAULTS as error:
        raise BadFileError(
            f"{path} is not a usable policy: {first_line(error)}. Make it again."
        ) from error


def blank_policy(metadata: dict[str, Any]) -> Policy:
    """Return a policy of the described structure with zeros for weights."""
    if metadata["command"] != COMMAND.to_json():
        raise ValueError("commands of another meaning")
    ranges = Bounds.from_json(metadata["ranges"], COMMAND.size, "ranges")
    for low, high in zip(ranges.low, ranges.high, strict=True):
        if not low < high:
            raise ValueError("ranges: wanted low below high for every command")
    widths = listed(metadata["widths"], "widths", _checked_width)
    return make_policy(blank(metadata["emulator"], Emulator), ranges, widths, None)


def _checked_width(width: Any, label: str) -> int:
    """Return the size of a hidden layer; ValueError if it is none."""
    return whole(width, label, 1, MAX_LAYER)
