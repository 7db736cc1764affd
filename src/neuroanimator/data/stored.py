"""A dataset that stays on disk: what is read of it a shard at a time, where it is too large for memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
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

STEPS_AT_ONCE = 4096
"""So many super steps are summed at a time, wherever shards end: then sums are the same bits, whatever lies in memory."""


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

    held_out = None
    """Likewise."""

    @cached_property
    def kept_runs(self) -> Int[np.ndarray, " D"]:
        """How many runs each shard holds, without those that diverged. All are read for it, and so checked."""
        return np.array([len(self.read(shard).runs.states) for shard in range(self.config.shards)])

    @property
    def windows(self) -> int:
        """How many windows there are."""
        return int(self.kept_runs.sum()) * self.config.samples_per_run

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


def open_to_measure(folder: str | Place) -> Transitions | StoredTransitions:
    """Return the dataset in `folder`, of which a shard at a time will be in memory; recordings are read.

    All of it is looked through once, so that BadFileError for a shard that is missing or damaged comes at once.
    """
    data = open_transitions(folder, memory=0)
    if isinstance(data, StoredTransitions):
        _ = data.kept_runs
    return data


class SuperStepRows(NamedTuple):
    """Training examples one by one: states, the controls given there, the states a super step later."""

    states: Float[np.ndarray, "N S"]
    controls: Float[np.ndarray, "N C"]
    following: Float[np.ndarray, "N S"]


def super_steps(data: Transitions | StoredTransitions) -> Iterator[SuperStepRows]:
    """Yield all training examples of `data` in their order, `STEPS_AT_ONCE` at a time, the last ones fewer."""
    if isinstance(data, Transitions):
        for first in range(0, len(data.states), STEPS_AT_ONCE):
            some = slice(first, first + STEPS_AT_ONCE)
            states = data.states[some]
            yield SuperStepRows(states[:, 0], data.controls[some, 0], states[:, 1])
        return
    left = _no_super_steps(data)
    for shard in range(data.config.shards):
        states, controls = data.read(shard).runs.windows(1)
        of_shard = SuperStepRows(states[:, 0], controls[:, 0], states[:, 1])
        left = _joined(left, of_shard)
        while len(left.states) >= STEPS_AT_ONCE:
            yield SuperStepRows(*(rows[:STEPS_AT_ONCE] for rows in left))
            left = SuperStepRows(*(rows[STEPS_AT_ONCE:] for rows in left))
    if len(left.states):
        yield left


def _no_super_steps(data: StoredTransitions) -> SuperStepRows:
    no_states = np.zeros((0, data.system.state.size), np.float32)
    no_controls = np.zeros((0, data.system.control.size), np.float32)
    return SuperStepRows(no_states, no_controls, no_states)


def _joined(first: SuperStepRows, second: SuperStepRows) -> SuperStepRows:
    pairs = zip(first, second, strict=True)
    return SuperStepRows(*(np.concatenate(pair) for pair in pairs))


def first_windows(data: Transitions | StoredTransitions, count: int) -> Transitions:
    """Return the first `count` windows of `data`, or all if there are fewer; of no more is anything read."""
    if isinstance(data, Transitions):
        return data.where(np.arange(len(data.states)) < count)
    states = []
    controls = []
    gathered = 0
    for shard in range(data.config.shards):
        if gathered >= count:
            break
        of_shard = data.read(shard).runs.windows(MAX_UNROLL)
        states.append(of_shard[0])
        controls.append(of_shard[1])
        gathered += len(of_shard[0])
    return data.transitions(np.concatenate(states)[:count], np.concatenate(controls)[:count])


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
