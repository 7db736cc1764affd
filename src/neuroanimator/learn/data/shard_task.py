"""One shard as a task for an executor: everything that it depends on, and the function that makes it."""

from __future__ import annotations

import secrets
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from neuroanimator.files.places import UrlPath
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.shard import Shard, make_shard
from neuroanimator.learn.data.shard_files import diverged_in, store_shard
from neuroanimator.physics import carried_system
from neuroanimator.physics.rigid.warnings import warnings_heard
from neuroanimator.systems.trusted_files import NO_FILES, TrustedFiles, trust_as_told

THIS_PROCESS = secrets.token_hex(8)
"""Identifier of this process, unique across machines."""


@dataclass(frozen=True)
class ShardTask:
    """Shard number `shard` of a dataset."""

    config: DatasetConfig
    shard: int
    threads: int
    """Number of threads; the bytes do not depend on it."""
    trusted: TrustedFiles = NO_FILES
    """Files that the submitting process may use, see `trusted_files.trusted_so_far`."""
    store: UrlPath | None = None
    """Store that the worker writes the shard to, unless it is there; None if the shard is sent back."""

    @property
    def label(self) -> str:
        """Its name in error messages."""
        return f"shard {self.shard}"


class MadeShard(NamedTuple):
    """A shard, and MuJoCo's warnings on the way."""

    shard: Shard | None
    """The shard; None if the worker has written it to the store."""
    diverged: int
    """Number of its runs that diverged."""
    warnings: Counter[str]
    process: str
    """`THIS_PROCESS` of the worker that made it."""


def run_shard_task(task: ShardTask) -> MadeShard:
    """Return the shard: a function of the task alone, except for MuJoCo's warnings."""
    trust_as_told(task.trusted)
    before = warnings_heard()
    system = _system_of(task.config.system, task.config.definition)
    shard = None
    diverged = None
    if task.store is not None:
        diverged = diverged_in(system, task.config, task.store, task.shard)
    if diverged is None:
        shard = make_shard(system, task.config, task.shard, task.threads)
        diverged = shard.diverged
        if task.store is not None:
            store_shard(shard, task.config, task.store, task.shard)
            shard = None
    return MadeShard(shard, diverged, warnings_heard() - before, THIS_PROCESS)


_system_of = lru_cache(maxsize=2)(carried_system)
"""A system, cached: a worker makes many shards of one."""
