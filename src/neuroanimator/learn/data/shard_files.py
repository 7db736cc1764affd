"""Shards in storage: check whether one is there, and write one."""

from __future__ import annotations

from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import write_tensors
from neuroanimator.files.places import Place
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.diverged_runs import has_diverged, write_diverged
from neuroanimator.learn.data.shard import Shard
from neuroanimator.learn.data.store import read_shard
from neuroanimator.systems.system import System


def diverged_in(system: System, config: DatasetConfig, folder: Place, shard: int) -> int | None:
    """Return the number of diverged runs of a complete shard; None for one that must be made."""
    try:
        _, metadata = read_shard(folder, config, system, shard)
    except BadFileError:
        return None
    if has_diverged(folder, config, shard, metadata["diverged"]):
        return metadata["diverged"]
    return None


def store_shard(made: Shard, config: DatasetConfig, folder: Place, shard: int) -> None:
    """Write a shard and its diverged runs."""
    write_diverged(folder, config, shard, made.starts, made.controls)
    metadata = {"kind": "shard", "config": config.hash, "shard": shard, "diverged": made.diverged}
    write_tensors(config.shard_path(folder, shard), made.tensors, metadata)
