"""The training windows of a dataset, in pools of the windows that fit into memory, from shards in random order.

A dataset that fits is one pool. For a larger one every epoch reorders the shards; pools are cut one after another from the
windows in that order: all of a shard, or, if few shards would fill a pool, some of every run. Batches are drawn from the
pool of their chunk, with replacement. The pools follow from the seed and their size alone, so a resumed run goes on as if
it had never stopped.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np
from jaxtyping import Int

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.store import Dataset, Transitions
from neuroanimator.learn.data.stored import memory_per_window, recut
from neuroanimator.learn.training.batches import rare_rows
from neuroanimator.learn.training.chunk import WindowsInMemory
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK, TrainingConfig
from neuroanimator.learn.training.survey import base_windows, training_windows

SHARD_ORDER = 11
"""Number of the random stream that orders shards."""

MIN_PARTS = 32
"""Minimum number of parts in a pool: windows of few runs are too much alike."""

SMALL_TIMES = 8
"""Number of times that windows fit into the memory if there is also room for a longer copy of them."""


@dataclass(frozen=True)
class Pools:
    """The pools of a training run."""

    data: Dataset
    base: Emulator
    """Emulator that encodes the windows."""
    config: TrainingConfig
    counts: Int[np.ndarray, " D"]
    """Number of training windows in each part of the data."""

    @property
    def epoch(self) -> int:
        """Number of windows in an epoch."""
        return int(self.counts.sum())

    @cached_property
    def window_memory(self) -> int:
        """Memory that a window takes [bytes]."""
        state_size = self.base.encode(np.asarray(self.base.rest, float)).shape[-1]
        return memory_per_window(state_size, self.base.control.size, self.data.system.window_steps)

    @cached_property
    def size(self) -> int:
        """Number of windows in a pool; ArgumentError if a part of the data does not fit."""
        if self.data.part_count == 1:
            return self.epoch
        room = self.config.memory // self.window_memory
        largest = int(self.counts.max())
        if room < largest:
            wanted = self.window_memory * largest // 10**6 + 1
            raise ArgumentError(
                f"memory: {self.config.memory / 1e6:.0f}MB holds no shard of this dataset; wanted at least {wanted}MB."
            )
        return min(room, self.epoch)

    @property
    def is_one(self) -> bool:
        """Whether one pool holds all windows, so that nothing depends on the memory."""
        return self.size == self.epoch

    @cached_property
    def passes(self) -> int:
        """Number of passes over all parts in an epoch, each for other windows of every run."""
        if self.is_one:
            return 1
        largest = int(self.counts.max())
        return max(1, -(-min(MIN_PARTS, len(self.counts)) * largest // self.size))

    @cached_property
    def of_chunks(self) -> Int[np.ndarray, " K"]:
        """Number of the pool of each chunk: a new one once the number of draws reaches that of its windows."""
        config = self.config
        if self.is_one:
            return np.zeros(config.chunks, int)
        sizes = [config.batch_at(config.unroll_at(chunk)) for chunk in range(config.chunks)]
        # Never more than a whole pool, so that none is left out.
        drawn = np.minimum(UPDATES_PER_CHUNK * np.array(sizes), self.size)
        return (np.cumsum(drawn) - drawn) // self.size

    def pools(self, first: int) -> Iterator[WindowsInMemory]:
        """Yield the pools from number `first` on: endlessly, or the one that holds all windows."""
        windows = recut(self._windows(first * self.size), self.size)
        if self.is_one:
            windows = islice(windows, 1)
        return map(self._in_memory, windows)  # a loop would keep the last one alive

    def _windows(self, position: int) -> Iterator[Transitions]:
        """Yield the latent windows of all epochs, one after another, from number `position` on, a part at a time."""
        epoch, skipped = divmod(position, self.epoch)
        while True:
            for offset in range(self.passes):
                rng = np.random.default_rng([self.config.seed, SHARD_ORDER, epoch, offset])
                for number in rng.permutation(len(self.counts)):
                    count = len(range(offset, int(self.counts[number]), self.passes))
                    if skipped < count:
                        windows = training_windows(self.data, int(number), self.config)
                        first = offset + skipped * self.passes
                        chosen = windows.where(slice(first, None, self.passes))
                        yield base_windows(self.base, chosen)
                    skipped = max(0, skipped - count)
            epoch += 1

    def _in_memory(self, windows: Transitions) -> WindowsInMemory:
        rare = rare_rows(self.base, windows) if self.config.rare_share else ()
        count = len(windows.states)
        missing = 0
        is_small = SMALL_TIMES * count * self.window_memory <= self.config.memory
        if self.is_one and is_small and not self.config.rare_share:
            missing = rounded_up(count) - count
        return WindowsInMemory(
            states=as_jax(lengthened(windows.states, missing)),
            controls=as_jax(lengthened(windows.controls, missing)),
            rare=as_jax(rare, np.int32),
            count=as_jax(count, np.int32),
        )


def lengthened(array: np.ndarray, missing: int) -> np.ndarray:
    """Return an array with `missing` rows of zeros at its end."""
    if not missing:
        return array
    return np.concatenate([array, np.zeros((missing, *array.shape[1:]), array.dtype)])


def rounded_up(count: int) -> int:
    """Return the next of few numbers, at most a quarter above `count`: those of three binary digits."""
    step = 1 << max(0, count.bit_length() - 3)
    return -(-count // step) * step
