"""Runs whose physics blew up: left out of the data, counted, and kept so that they can be replayed.

starts, controls = read_diverged("data/fish")
system.simulate(starts, controls, dt)  # blows up again
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from neuroanimator.data.shard_checks import Wanted, check_tensors
from neuroanimator.data.transitions import RUN_STEPS, DatasetConfig, read_config
from neuroanimator.errors import BadFileError
from neuroanimator.storage.files import read_tensors, write_tensors
from neuroanimator.systems import load_system

KIND = "diverged"
PATTERN = "diverged-*.safetensors"
"""Names of these files in a dataset's folder; one for each shard that had such runs."""


def write_diverged(
    folder: Path, config: DatasetConfig, shard: int, starts: np.ndarray, controls: np.ndarray
) -> None:
    """Write the starts (B, S) and controls (B, T, C) of a shard's runs that blew up; nothing if none did.

    Raises BadFileError if other such runs are there already; a damaged file is made again.
    """
    path = _path(folder, shard)
    tensors = {"starts": starts.astype(np.float64), "controls": controls.astype(np.float64)}
    try:
        there, metadata = read_tensors(path, KIND)
    except BadFileError:
        there, metadata = {}, {}
    if there:
        is_same = all(np.array_equal(there.get(name, np.nan), tensors[name]) for name in tensors)
        if not is_same or not _belongs(there, metadata, config, shard):
            raise BadFileError(
                f"{path} holds other runs than this dataset's. Move it away, and generate again."
            )
    elif len(starts):
        write_tensors(path, tensors, {"kind": KIND, "config": config.hash, "shard": shard})


def has_diverged(folder: Path, config: DatasetConfig, shard: int, count: int) -> bool:
    """Return whether all `count` runs of a shard that blew up are there to be replayed."""
    if not count:
        return True
    try:
        tensors, metadata = read_tensors(_path(folder, shard), KIND)
    except BadFileError:
        return False
    return _belongs(tensors, metadata, config, shard) and len(tensors["starts"]) == count


def read_diverged(folder: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Return starts (B, S) and controls (B, T, C) of all runs that blew up, each control held for one super step.

    Raises BadFileError if a file is damaged or belongs to another dataset.
    """
    folder = Path(folder)
    config = read_config(folder)
    system = load_system(config.system, config.definition)
    found = []
    for shard in range(config.shards):
        if (path := _path(folder, shard)).exists():
            tensors, metadata = read_tensors(path, KIND)
            wanted = {
                "starts": Wanted(np.float64, (None, system.state.size)),
                "controls": Wanted(np.float64, (None, RUN_STEPS, system.control.size)),
            }
            check_tensors(path, tensors, wanted)
            if not _belongs(tensors, metadata, config, shard):
                raise BadFileError(f"{path} belongs to another dataset. Move it away.")
            found.append((tensors["starts"], tensors["controls"]))
    if not found:
        return np.zeros((0, 0)), np.zeros((0, 0, 0))
    starts, controls = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return starts, controls


def _path(folder: Path, shard: int) -> Path:
    return folder / PATTERN.replace("*", f"{shard:05d}")


def _belongs(
    tensors: dict[str, np.ndarray], metadata: dict[str, object], config: DatasetConfig, shard: int
) -> bool:
    named = (metadata.get("config"), metadata.get("shard")) == (config.hash, shard)
    return (
        named
        and set(tensors) == {"starts", "controls"}
        and len(tensors["starts"]) == len(tensors["controls"])
    )
