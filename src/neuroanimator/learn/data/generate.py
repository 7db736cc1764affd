"""Simulate, sample, store: resumable, and the same bytes for any number of threads, processes and machines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from neuroanimator.codegen.cores import core_count
from neuroanimator.errors import ArgumentError, NeuroAnimatorError
from neuroanimator.executor.executor import Executor, LostTaskError, raise_first
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.files.atomic import locked
from neuroanimator.files.places import Place, UrlPath, place_of
from neuroanimator.files.unfinished import remove_stale
from neuroanimator.learn.data.config import RUNS_PER_SHARD, DatasetConfig
from neuroanimator.learn.data.recorded_segments import limited_to_recordings
from neuroanimator.learn.data.recorded_windows import write_held_out
from neuroanimator.learn.data.shard import make_shard
from neuroanimator.learn.data.shard_files import diverged_in, store_shard
from neuroanimator.learn.data.shard_task import THIS_PROCESS, MadeShard, ShardTask, run_shard_task
from neuroanimator.learn.data.store import (
    Transitions,
    claim_folder,
    join_transitions,
    shard_transitions,
)
from neuroanimator.physics import carried_system
from neuroanimator.physics.rigid.warnings import also_heard
from neuroanimator.systems.trusted_files import trusted_so_far


def generate(
    config: DatasetConfig,
    folder: str | Place,
    *,
    threads: int | None = None,
    executor: Executor | None = None,
    on_shard: Callable[[], None] = lambda: None,
) -> int:
    """Fill `folder`, or a URL of a store, with the dataset of `config`; return the number of runs that diverged, left out.

    Existing shards are kept, damaged ones made again. `on_shard` is called after each. The runs that diverged
    can be replayed, see `learn.data.diverged_runs`. If recordings hold fewer transitions than `count`, it is lowered,
    see `limited_to_recordings`.

    `executor` makes the shards, or this process if there is none. `threads` is the number per shard: None or 0 for those
    of the executor, or for all cores.
    """
    folder = place_of(folder)
    if not threads and executor is not None:
        threads = executor.threads
    threads = _checked_threads(threads)
    system = carried_system(config.system, config.definition)
    config = limited_to_recordings(config, system)
    with locked(folder):
        claim_folder(folder, config)
        if isinstance(folder, Path):
            remove_stale(folder)
        diverged = 0
        tasks = []
        store = folder if isinstance(folder, UrlPath) else None
        for shard in range(config.shards):
            dropped = None
            # A shard in a store is read by the worker whose task it is.
            if store is None:
                dropped = diverged_in(system, config, folder, shard)
            if dropped is None:
                tasks.append(ShardTask(config, shard, threads, trusted_so_far(), store))
            else:
                diverged += dropped
                on_shard()
        for shard, made in _made(tasks, executor or LocalExecutor(1, threads)):
            if made.shard is not None:
                store_shard(made.shard, config, folder, shard)
            diverged += made.diverged
            on_shard()
        if system.recordings is not None:
            write_held_out(system.recordings, config, folder)
    return diverged


def simulate_transitions(config: DatasetConfig, threads: int | None = None) -> Transitions:
    """Return the dataset of `config` without storing it."""
    threads = _checked_threads(threads)
    system = carried_system(config.system, config.definition)
    config = limited_to_recordings(config, system)
    parts = []
    for shard in range(config.shards):
        made = make_shard(system, config, shard, threads)
        metadata = {"shard": shard, "diverged": made.diverged}
        parts.append(shard_transitions(config, system, made.tensors, metadata))
    return join_transitions(parts)


def _checked_threads(threads: int | None) -> int:
    """Return the number of threads to use; ArgumentError for a negative number."""
    if threads is not None and threads < 0:
        raise ArgumentError(f"threads: wanted 1 or more, or 0 for all cores; got {threads}.")
    # More threads than runs in a shard would be idle, and each takes memory.
    return min(threads or core_count(), RUNS_PER_SHARD)


def _made(tasks: list[ShardTask], executor: Executor) -> Iterator[tuple[int, MadeShard]]:
    """Yield (number, shard) as each is made.

    An error in one shard would occur in all, and is raised at once; shards whose workers died are reported at the end.
    """
    lost: dict[int, NeuroAnimatorError] = {}
    for outcome in executor.outcomes(run_shard_task, tasks):
        if isinstance(outcome.error, LostTaskError):
            lost[outcome.index] = outcome.error
            continue
        made = outcome.value()
        if made.process != THIS_PROCESS:
            also_heard(made.warnings)
        yield tasks[outcome.index].shard, made
    raise_first(lost, len(tasks))
