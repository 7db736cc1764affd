"""Runs whose physics diverged: left out of the data, counted, and kept so that they can be replayed.

starts, controls = read_diverged("data/fish")
system.simulate(starts, controls, dt)  # diverges again
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import Tensors, read_tensors, write_tensors
from neuroanimator.files.places import Place, place_of
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.shard_checks import TensorSpec, check_tensors
from neuroanimator.learn.data.store import read_config
from neuroanimator.physics import load_system

KIND = "diverged"
"""Kind of these files, as their metadata states it."""

PATTERN = "diverged-*.safetensors"
"""Names of these files in a dataset's folder; one for each shard that had such runs."""

NAMES = {"starts", "controls"}
"""The tensors of these files."""


def write_diverged(
    folder: Place,
    config: DatasetConfig,
    shard: int,
    starts: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
) -> None:
    """Write the starts and controls of a shard's diverged runs; nothing if there are none.

    Raises BadFileError if the file holds other runs; a damaged file is made again.
    """
    path = _path(folder, shard)
    tensors = {"starts": starts.astype(np.float64), "controls": controls.astype(np.float64)}
    is_other = False
    with suppress(BadFileError):
        present, metadata = read_tensors(path, KIND)
        is_other = not _belongs(present, metadata, config, shard)
    if is_other:
        raise BadFileError(
            f"{path} holds runs of another dataset. Move it away, and generate again."
        )
    if len(starts):
        write_tensors(path, tensors, {"kind": KIND, "config": config.hash, "shard": shard})


def has_diverged(folder: Place, config: DatasetConfig, shard: int, count: int) -> bool:
    """Return whether all `count` diverged runs of a shard are stored, ready to be replayed."""
    if not count:
        return True
    try:
        tensors, metadata = read_tensors(_path(folder, shard), KIND)
    except BadFileError:
        return False
    return _belongs(tensors, metadata, config, shard) and len(tensors["starts"]) == count


class DivergedRuns(NamedTuple):
    """Runs that diverged."""

    starts: Float[np.ndarray, "B S"]
    controls: Float[np.ndarray, "B T C"]
    """Controls, each held for one super step."""


def read_diverged(folder: str | Place) -> DivergedRuns:
    """Return starts (B, S) and controls (B, T, C) of all runs that diverged, each control held for one super step.

    Raises BadFileError if a file is damaged or belongs to another dataset.
    """
    parts = list(diverged_by_shard(folder))
    if not parts:
        return DivergedRuns(np.zeros((0, 0)), np.zeros((0, 0, 0)))
    starts = np.concatenate([part.starts for part in parts])
    controls = np.concatenate([part.controls for part in parts])
    return DivergedRuns(starts, controls)


def diverged_by_shard(folder: str | Place) -> Iterator[DivergedRuns]:
    """Yield the runs that diverged, one shard at a time; raises what `read_diverged` raises."""
    folder = place_of(folder)
    config = read_config(folder)
    system = load_system(config.system, config.definition)
    specs = {
        "starts": TensorSpec(np.float64, (None, system.state.size)),
        "controls": TensorSpec(np.float64, (None, system.run_steps, system.control.size)),
    }
    for shard in range(config.shards):
        path = _path(folder, shard)
        if not path.exists():
            continue
        tensors, metadata = read_tensors(path, KIND)
        check_tensors(path, tensors, specs)
        if not _belongs(tensors, metadata, config, shard):
            raise BadFileError(f"{path} belongs to another dataset. Move it away.")
        yield DivergedRuns(tensors["starts"], tensors["controls"])


def _path(folder: Place, shard: int) -> Place:
    return folder / PATTERN.replace("*", f"{shard:05d}")


def _belongs(
    tensors: Tensors, metadata: dict[str, object], config: DatasetConfig, shard: int
) -> bool:
    is_of_shard = (metadata.get("config"), metadata.get("shard")) == (config.hash, shard)
    if not is_of_shard or set(tensors) != NAMES:
        return False
    return len(tensors["starts"]) == len(tensors["controls"])
