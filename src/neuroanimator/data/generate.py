"""Simulate, sample, store: resumable, and the same bytes for any number of threads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.data.config import (
    MAX_GAP,
    MAX_UNROLL,
    RUN_STEPS,
    RUNS_PER_SHARD,
    SAMPLES_PER_RUN,
    DatasetConfig,
)
from neuroanimator.data.diverged_runs import has_diverged, write_diverged
from neuroanimator.data.recorded_segments import limited_to_recordings
from neuroanimator.data.recorded_windows import cut_shard, write_held_out
from neuroanimator.data.sampling import sample_control_runs, sample_starts, with_idle_runs
from neuroanimator.data.store import (
    Transitions,
    claim_folder,
    gather_transitions,
    read_shard,
)
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.storage.files import locked, write_tensors
from neuroanimator.storage.unfinished import remove_stale
from neuroanimator.systems import carried_system
from neuroanimator.systems.cores import core_count
from neuroanimator.systems.system import System


def generate(
    config: DatasetConfig,
    folder: str | Path,
    *,
    threads: int | None = None,
    on_shard: Callable[[], None] = lambda: None,
) -> int:
    """Fill `folder` with the dataset `config` describes; return how many runs diverged and were dropped.

    Shards already there are kept, damaged ones made again. `on_shard` is called as each is done. The runs that blew
    up can be replayed, see `data.diverged_runs`. `threads`: none, or 0, for all cores. Recordings hold only so many
    transitions: `count` is then lowered, see `limited_to_recordings`.
    """
    folder = Path(folder)
    threads = _checked_threads(threads)
    config = limited_to_recordings(config)
    system = carried_system(config.system, config.definition)
    with locked(folder):
        claim_folder(folder, config)
        remove_stale(folder)
        diverged = 0
        for shard in range(config.shards):
            diverged += _ensure_shard(system, config, folder, shard, threads)
            on_shard()
        if system.recordings is not None:
            write_held_out(system.recordings, config, folder)
    return diverged


def simulate_transitions(config: DatasetConfig, threads: int | None = None) -> Transitions:
    """Return the dataset `config` describes without storing it."""
    threads = _checked_threads(threads)
    config = limited_to_recordings(config)
    system = carried_system(config.system, config.definition)
    shards = (make_shard(system, config, shard, threads) for shard in range(config.shards))
    counted = ((shard.tensors, shard.diverged) for shard in shards)
    return gather_transitions(config, system, counted)


def _checked_threads(threads: int | None) -> int:
    """Return how many threads to use; ArgumentError for fewer than none."""
    if threads is not None and threads < 0:
        raise ArgumentError(f"threads: wanted 1 or more, or 0 for all cores; came {threads}.")
    # More than a shard has runs would have nothing to do, and each takes memory.
    return min(threads or core_count(), RUNS_PER_SHARD)


class Shard(NamedTuple):
    """A shard, and what was left out of it."""

    tensors: dict[str, np.ndarray]
    starts: Float[np.ndarray, "B S"]
    """Where the runs began that diverged."""
    controls: Float[np.ndarray, "B T C"]
    """What the runs were driven by that diverged."""

    @property
    def diverged(self) -> int:
        """How many runs diverged."""
        return len(self.starts)


def _ensure_shard(
    system: System, config: DatasetConfig, folder: Path, shard: int, threads: int
) -> int:
    """Return how many of a shard's runs diverged; the shard is made unless it is there."""
    try:
        _, metadata = read_shard(folder, config, system, shard)
        if has_diverged(folder, config, shard, metadata["diverged"]):
            return metadata["diverged"]
    except BadFileError:
        pass
    made = make_shard(system, config, shard, threads)
    write_diverged(folder, config, shard, made.starts, made.controls)
    metadata = {"kind": "shard", "config": config.hash, "shard": shard, "diverged": made.diverged}
    write_tensors(config.shard_path(folder, shard), made.tensors, metadata)
    return made.diverged


def make_shard(system: System, config: DatasetConfig, shard: int, threads: int) -> Shard:
    """Return shard number `shard`: a function of its arguments alone."""
    if system.recordings is not None:
        return Shard(
            cut_shard(system.recordings, config, shard), np.zeros((0, 0)), np.zeros((0, 0, 0))
        )
    rng = np.random.default_rng([config.seed, shard])
    count = min(RUNS_PER_SHARD, config.runs - shard * RUNS_PER_SHARD)
    dt = config.substeps * system.physics_dt
    starts = sample_starts(system, rng, count, threads)
    controls = sample_control_runs(rng, count, RUN_STEPS, dt, system)
    samples = np.stack([sample_steps(rng, config.samples_per_run) for _ in range(count)])
    controls = with_idle_runs(rng, controls, system.bounds, config.idle_share)
    runs = system.simulate(starts, controls, dt, threads=threads)
    is_whole = ~runs.has_diverged
    tensors = {
        "states": runs.states[is_whole].astype(np.float32),
        "controls": controls[is_whole].astype(np.float32),
        "samples": samples[is_whole].astype(np.int32),
    }
    return Shard(tensors, starts[runs.has_diverged], controls[runs.has_diverged])


def sample_steps(rng: np.random.Generator, count: int) -> Int[np.ndarray, " K"]:
    """Return the `count` super steps of one run that become examples, 1 to 5 apart (eq. 8)."""
    last = RUN_STEPS - MAX_UNROLL
    largest_gap = MAX_GAP * SAMPLES_PER_RUN // count
    while True:
        gaps = rng.integers(1, largest_gap + 1, count)
        steps = np.cumsum(gaps) - 1
        if steps[-1] <= last:
            return steps
