"""Make one shard: draw starts and controls, simulate the physics, sample super steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.files.atomic import Tensors
from neuroanimator.learn.data.config import (
    MAX_GAP,
    MAX_UNROLL,
    RUN_STEPS,
    RUNS_PER_SHARD,
    SAMPLES_PER_RUN,
    DatasetConfig,
)
from neuroanimator.learn.data.recorded_windows import cut_shard
from neuroanimator.learn.data.sampling import sample_starts, with_held_runs, with_idle_runs
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System


class Shard(NamedTuple):
    """A shard, and the runs left out of it."""

    tensors: Tensors
    starts: Float[np.ndarray, "B S"]
    """Starts of the runs that diverged."""
    controls: Float[np.ndarray, "B T C"]
    """Controls of the runs that diverged."""

    @property
    def diverged(self) -> int:
        """Number of runs that diverged."""
        return len(self.starts)


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
    controls = sample_control_runs(rng, count, system.run_steps, dt, system)
    examples = config.samples_per_run
    samples = [
        sample_steps(rng, examples, system.run_steps, system.window_steps) for _ in range(count)
    ]
    if system.structure.shape_contacts is None:
        starts, controls = with_held_runs(system, rng, starts, controls, config.held_share, threads)
    controls = with_idle_runs(rng, controls, system.bounds, config.idle_share)
    runs = system.simulate(starts, controls, dt, threads=threads)
    is_whole = ~runs.has_diverged
    tensors = {
        "states": runs.states[is_whole].astype(np.float32),
        "controls": controls[is_whole].astype(np.float32),
        "samples": np.stack(samples)[is_whole].astype(np.int32),
    }
    return Shard(tensors, starts[runs.has_diverged], controls[runs.has_diverged])


def sample_steps(
    rng: np.random.Generator,
    count: int,
    run_steps: int = RUN_STEPS,
    window_steps: int = MAX_UNROLL,
) -> Int[np.ndarray, " K"]:
    """Return the `count` super steps of one run that become examples, 1 to 5 apart in usual runs (eq. 8)."""
    last = run_steps - window_steps
    largest_gap = MAX_GAP * SAMPLES_PER_RUN * run_steps // (RUN_STEPS * count)
    while True:
        gaps = rng.integers(1, largest_gap + 1, count)
        steps = np.cumsum(gaps) - 1
        if steps[-1] <= last:
            return steps
