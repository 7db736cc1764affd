"""What must be known of a dataset that stays on disk before training begins: each shard is read, and let go."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from neuroanimator.data.config import MAX_UNROLL
from neuroanimator.data.store import Transitions
from neuroanimator.data.stored import NUMBER_SIZE, Runs, StoredTransitions, held_out_runs
from neuroanimator.errors import ArgumentError
from neuroanimator.training.config import TrainingConfig

SAMPLE = 300_000
"""So many windows shape modes, symmetries and what is rare are found by, at most: as many as a usual dataset has."""

SAMPLE_SHARDS = 64
"""Shards they come from, spread over the whole dataset, at most."""

SAMPLE_SHARE = 0.25
"""Share of the memory that the sample, and what is computed of it, may take."""

SAMPLE_COPIES = 6
"""So many times itself a sample takes while it is encoded in double precision."""

MAX_VALIDATION = 8192
"""Windows used for validation, at most: more would slow training and change no digit that matters."""


def training_runs(runs: Runs, config: TrainingConfig, shard: int) -> Runs:
    """Return those of a shard's runs that are learnt from."""
    return runs.where(~_held_out(runs, config, shard))


def sample_of(data: StoredTransitions, config: TrainingConfig) -> Transitions:
    """Return single super steps of training runs from all over the dataset, as many as there is memory for."""
    numbers = 2 * data.system.state.size + data.system.control.size
    room = SAMPLE_SHARE * config.memory / (SAMPLE_COPIES * NUMBER_SIZE * numbers)
    count = min(SAMPLE, max(1, int(room)))
    return _gathered(data, config, count, unroll=1, is_held_out=False)


def validation_of(data: StoredTransitions, config: TrainingConfig) -> Transitions:
    """Return windows of runs that are kept for validation, from all over the dataset."""
    return _gathered(data, config, MAX_VALIDATION, unroll=MAX_UNROLL, is_held_out=True)


def _gathered(
    data: StoredTransitions, config: TrainingConfig, count: int, *, unroll: int, is_held_out: bool
) -> Transitions:
    """Return at most `count` windows of `unroll` super steps, of shards that lie evenly apart; ArgumentError for none."""
    shards = np.unique(np.linspace(0, data.config.shards - 1, SAMPLE_SHARDS).astype(int))
    of_each = -(-count // len(shards))
    states = []
    controls = []
    for shard in shards:
        runs = data.read(int(shard)).runs
        runs = runs.where(_held_out(runs, config, int(shard)) == is_held_out)
        every = max(1, runs.samples.size // of_each)
        shard_states, shard_controls = runs.windows(unroll)
        states.append(shard_states[::every][:of_each])
        controls.append(shard_controls[::every][:of_each])
    gathered = data.transitions(np.concatenate(states)[:count], np.concatenate(controls)[:count])
    if not len(gathered.states):
        raise ArgumentError(
            f"{data.folder}: no runs to learn from or to validate by; too many diverged."
        )
    return gathered


@dataclass
class Survey:
    """One reading of all training windows; how many there were is known when it is over."""

    data: StoredTransitions
    config: TrainingConfig
    sha256: list[str] = field(default_factory=list)
    """Of the shards read so far."""
    counts: list[int] = field(default_factory=list)
    """How many training windows each had."""

    def parts(self) -> Iterator[Transitions]:
        """Yield the single super steps of the training windows, a shard at a time."""
        for shard in range(self.data.config.shards):
            stored = self.data.read(shard)
            runs = training_runs(stored.runs, self.config, shard)
            self.sha256.append(stored.sha256)
            self.counts.append(runs.samples.size)
            if runs.samples.size:
                yield self.data.transitions(*runs.windows(1))


def _held_out(runs: Runs, config: TrainingConfig, shard: int) -> np.ndarray:
    """Return which of a shard's runs are kept for validation."""
    return held_out_runs(config.seed, config.validation_share, shard, len(runs.states))
