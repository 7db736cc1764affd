"""A dataset that stays on disk: what is read of it a shard at a time, where it is too large for memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.data.config import MAX_UNROLL, DatasetConfig
from neuroanimator.data.store import Transitions, read_config, read_shard, read_transitions
from neuroanimator.storage.places import Place, place_of
from neuroanimator.systems import carried_system
from neuroanimator.systems.system import System

COPIES = 5
"""So many times its windows a dataset takes in memory while an emulator is made for it: they are gathered, split into
some to learn from and some to validate by, encoded, and handed to JAX."""

DEFAULT_MEMORY = 8 * 10**9
"""Memory for a dataset if nothing else is said [bytes]: every one that is usual for what ships fits."""

NUMBER_SIZE = 4
"""Size of a number in a shard, and in a network [bytes]."""


class Runs(NamedTuple):
    """The runs of one shard, and the super steps of each that are training examples."""

    states: Float[np.ndarray, "R T S"]
    controls: Float[np.ndarray, "R H C"]
    samples: Int[np.ndarray, "R K"]

    def where(self, mask: Bool[np.ndarray, " R"]) -> Runs:
        """Return the runs `mask` selects."""
        return Runs(self.states[mask], self.controls[mask], self.samples[mask])

    def windows(self, unroll: int) -> tuple[Float[np.ndarray, "N F S"], Float[np.ndarray, "N U C"]]:
        """Return (states, controls) of the windows of `unroll` super steps that begin at the samples; F = U + 1."""
        rows = np.arange(len(self.states))[:, None, None]
        steps = self.samples[:, :, None] + np.arange(unroll + 1)
        states = self.states[rows, steps]
        controls = self.controls[rows, steps[..., :-1]]
        windows = states.reshape(-1, *states.shape[2:])
        return windows, controls.reshape(-1, *controls.shape[2:])


class StoredShard(NamedTuple):
    """What one file of a dataset holds."""

    runs: Runs
    sha256: str
    """Names all that is in the file."""


@dataclass(frozen=True)
class StoredTransitions:
    """A dataset of simulated runs in a folder. It takes no memory; shards are read, and checked, as they are asked for."""

    folder: Place
    config: DatasetConfig
    system: System

    noise = None
    """Of recordings only, which are always read into memory."""

    def read(self, shard: int) -> StoredShard:
        """Return shard number `shard`; BadFileError if it is missing, damaged or of another dataset."""
        tensors, metadata = read_shard(self.folder, self.config, self.system, shard)
        runs = Runs(tensors["states"], tensors["controls"], tensors["samples"])
        return StoredShard(runs, metadata["sha256"])

    def transitions(
        self, states: Float[np.ndarray, "N T S"], controls: Float[np.ndarray, "N H C"]
    ) -> Transitions:
        """Return some windows of this dataset as one in memory. Which runs they come from is not said."""
        run = np.zeros(len(states), int)
        return Transitions(self.config, self.system, states, controls, run, diverged=0)


def open_transitions(
    folder: str | Place, memory: int = DEFAULT_MEMORY
) -> Transitions | StoredTransitions:
    """Return the dataset in `folder`, read into memory if it and its copies fit into `memory` [bytes].

    Recordings are always read: they lay in memory when their dataset was made. Raises BadFileError as
    `read_transitions` does, for a dataset that stays on disk when its shards are read.
    """
    folder = place_of(folder)
    config = read_config(folder)
    system = carried_system(config.system, config.definition)
    if system.recordings is not None or memory_taken(config, system) <= memory:
        return read_transitions(folder)
    return StoredTransitions(folder, config, system)


def memory_taken(config: DatasetConfig, system: System) -> int:
    """Return how much memory training takes for this dataset if all of it is read [bytes]."""
    numbers = (MAX_UNROLL + 1) * system.state.size + MAX_UNROLL * system.control.size
    windows = config.runs * config.samples_per_run
    return COPIES * windows * numbers * NUMBER_SIZE


def held_out_runs(seed: int, share: float, shard: int, runs: int) -> Bool[np.ndarray, " R"]:
    """Return which of the `runs` runs in shard number `shard` are kept for validation: a function of the arguments alone."""
    chosen = np.random.default_rng([seed, 1, shard]).permutation(runs)[: round(runs * share)]
    mask = np.zeros(runs, bool)
    mask[chosen] = True
    return mask
