"""The windows of a dataset that stays on disk, in random order: shards shuffled, and the windows of some shards at a time.

An epoch shows every window once. Its shards come in random order; as many as fit into memory are a pool, whose windows
are mixed. The order follows from the seed and how large a pool is alone, so a stream that is taken up anywhere goes on
as if it had never stopped.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.data.config import RUN_STEPS, RUNS_PER_SHARD
from neuroanimator.data.stored import NUMBER_SIZE, Runs, StoredTransitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.training.batches import unusualness
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.prefetch import Prefetched
from neuroanimator.training.survey import training_runs

SHARD_ORDER = 11
"""Tells the random numbers that order shards from others of the same seed."""

WINDOW_ORDER = 12
"""The same of those that mix the windows of a pool."""

RARE_ORDER = 13
"""The same of those that draw rare windows."""

POOL_SHARE = 0.3
"""Share of the memory that a pool may take. There are two: one is filled while the other is used."""

BLOCK_SHARE = 0.08
"""Share of the memory that a block of batches may take. There are four: in the making, waiting twice, and learnt from."""

BLOCKS_AHEAD = 2
"""So many blocks of batches are made ahead, for now and then one has to wait for a shard."""

STATES_OF_RUN = RUN_STEPS + 1
"""States in a run, both ends included."""

WINDOW_BYTES = 16
"""What a pool keeps of a window besides its run, while windows are mixed: where it begins, and whether it is rare [bytes]."""


class Demand(NamedTuple):
    """What a block is made for: some consecutive updates of a chunk."""

    chunk: int
    first_update: int
    """Counted from the chunk's first."""
    updates: int
    size: int
    """Windows in a batch."""
    unroll: int


class Block(NamedTuple):
    """The batches of consecutive updates U."""

    windows: Float[np.ndarray, "U B F V"]
    """Of F = H + 1 latent states, each followed by the latent control after it; the last control means nothing."""
    weights: Float[np.ndarray, "U B"] | None
    """Of windows, where rare ones are drawn more often."""


@dataclass(frozen=True)
class WindowStream:
    """The training windows of a dataset on disk, in the random order in which they are learnt from."""

    data: StoredTransitions
    base: Emulator
    """Which encodes the windows."""
    config: TrainingConfig
    sha256: tuple[str, ...]
    """What each shard held when the stream was made."""
    counts: Int[np.ndarray, " D"]
    """Training windows in each shard."""
    rare_from: float
    """How unusual the change of a rare window is at least."""

    @property
    def epoch(self) -> int:
        """How many windows an epoch has."""
        return int(self.counts.sum())

    @property
    def shards_per_pool(self) -> int:
        """How many shards lie in memory at a time; ArgumentError if there is not room for one."""
        room = POOL_SHARE * self.config.memory
        shard = self._shard_size()
        if shard > room:
            wanted = int(shard / POOL_SHARE / 1e6) + 1
            raise ArgumentError(
                f"memory: {self.config.memory / 1e6:.0f}MB holds no shard of this dataset; wanted at least {wanted}MB."
            )
        return int(room / shard)

    def updates_per_block(self, updates: int, size: int, unroll: int) -> int:
        """Return how many updates a block is made for: a divisor of a chunk's `updates`, by the memory there is."""
        state_size, control_size = self._sizes()
        numbers = (unroll + 1) * (state_size + control_size)
        batch = NUMBER_SIZE * numbers * size
        most = max(1, int(BLOCK_SHARE * self.config.memory / batch))
        return max(
            count for count in range(1, updates + 1) if updates % count == 0 and count <= most
        )

    def new_per_batch(self, size: int) -> int:
        """Return how many windows of a batch come from the stream; the others are drawn among the rare ones."""
        return max(1, size - round(size * self.config.rare_share))

    def blocks(self, demands: Iterator[Demand], position: int) -> Iterator[Block]:
        """Yield a block for each of `demands`; its first window is number `position` of all epochs one after another."""
        pools = Prefetched(self.pools(position), depth=1)
        try:
            reader = _Reader(pools)
            for demand in demands:
                yield self._block(reader, demand)
        finally:
            pools.close()

    def pools(self, position: int) -> Iterator[Pool]:
        """Yield pools without end, the first from window number `position` of all epochs on."""
        seed = self.config.seed
        per_pool = self.shards_per_pool
        epoch, skipped = divmod(position, self.epoch)
        while True:
            shard_rng = np.random.default_rng([seed, SHARD_ORDER, epoch])
            shards = shard_rng.permutation(len(self.counts))
            for first in range(0, len(shards), per_pool):
                chosen = shards[first : first + per_pool]
                count = int(self.counts[chosen].sum())
                if skipped < count:
                    rng = np.random.default_rng([seed, WINDOW_ORDER, epoch, first])
                    yield self._pool(chosen, rng, skipped)
                skipped = max(0, skipped - count)
            epoch += 1

    def _pool(self, shards: Int[np.ndarray, " P"], rng: np.random.Generator, skipped: int) -> Pool:
        """Return the windows of `shards`, mixed, to be read from number `skipped` on."""
        state_size, control_size = self._sizes()
        steps = len(shards) * RUNS_PER_SHARD * STATES_OF_RUN
        numbers = np.zeros((steps, state_size + control_size), np.float32)
        begins = np.zeros(int(self.counts[shards].sum()), np.int32)
        step = 0
        window = 0
        for shard in shards:
            runs = self._training_runs(int(shard))
            rows = len(runs.states)
            last_step = step + rows * STATES_OF_RUN
            last_window = window + runs.samples.size
            of_runs = numbers[step:last_step].reshape(rows, STATES_OF_RUN, -1)
            of_runs[..., :state_size] = self.base.encoding.encode_recorded(runs.states)
            of_runs[:, :-1, state_size:] = self.base.encode_control(runs.controls)
            firsts = step + np.arange(rows) * STATES_OF_RUN
            begins[window:last_window] = (firsts[:, None] + runs.samples).reshape(-1)
            step = last_step
            window = last_window
        rng.shuffle(begins)
        is_rare = np.zeros(len(begins), bool)
        if self.config.rare_share:
            is_rare = self._is_rare(numbers[:, :state_size], begins)
        return Pool(numbers, begins, is_rare, begins[is_rare], skipped)

    def _is_rare(
        self, states: Float[np.ndarray, "N I"], begins: Int[np.ndarray, " M"]
    ) -> Bool[np.ndarray, " M"]:
        """Return which windows are rare, a shard's worth of them at a time."""
        at_once = RUNS_PER_SHARD * self.data.config.samples_per_run
        is_rare = np.zeros(len(begins), bool)
        for first in range(0, len(begins), at_once):
            some = slice(first, first + at_once)
            at = begins[some]
            is_rare[some] = unusualness(self.base, states[at], states[at + 1]) >= self.rare_from
        if not is_rare.any():
            is_rare[:] = True
        return is_rare

    def _training_runs(self, shard: int) -> Runs:
        """Return the runs of a shard that are learnt from; BadFileError if it is not what it was."""
        stored = self.data.read(shard)
        if stored.sha256 != self.sha256[shard]:
            path = self.data.config.shard_path(self.data.folder, shard)
            raise BadFileError(f"{path} has changed since training began. Start it again.")
        return training_runs(stored.runs, self.config, shard)

    def _block(self, reader: _Reader, demand: Demand) -> Block:
        """Return the batches of the windows that come next."""
        batches = (demand.updates, -1, demand.unroll + 1, sum(self._sizes()))
        new = self.new_per_batch(demand.size)
        rare_share = 1 - new / demand.size
        windows, is_rare = reader.take(demand.updates * new, demand.unroll + 1)
        windows = windows.reshape(batches)
        if not rare_share:
            return Block(windows, None)
        pool = reader.pool
        keys = [self.config.seed, RARE_ORDER, demand.chunk, demand.first_update]
        drawn = demand.updates * (demand.size - new)
        begins = np.random.default_rng(keys).choice(pool.rare, drawn)
        rare_windows = windows_at(pool.numbers, begins, demand.unroll + 1).reshape(batches)
        # Importance sampling: what is drawn more often counts less, so that the mean loss stays what it was.
        rare_weight = 1 / (1 - rare_share + rare_share * len(pool.begins) / len(pool.rare))
        weights = np.full((demand.updates, demand.size), rare_weight, np.float32)
        is_usual = ~is_rare.reshape(demand.updates, new)
        weights[:, :new][is_usual] = 1 / (1 - rare_share)
        return Block(np.concatenate([windows, rare_windows], axis=1), weights)

    def _sizes(self) -> tuple[int, int]:
        """Return how many numbers a latent state and a latent control have."""
        latent = self.base.encode(np.asarray(self.base.rest, float))
        return latent.shape[-1], self.base.control.size

    def _shard_size(self) -> int:
        """Return how much memory a full shard takes in a pool [bytes]."""
        state_size, control_size = self._sizes()
        run = NUMBER_SIZE * STATES_OF_RUN * (state_size + control_size)
        return RUNS_PER_SHARD * (run + WINDOW_BYTES * self.data.config.samples_per_run)


class Pool(NamedTuple):
    """The windows of some shards, mixed."""

    numbers: Float[np.ndarray, "N V"]
    """Latent states of all runs, one run after another, each with the latent control after it."""
    begins: Int[np.ndarray, " M"]
    """At which state each window begins."""
    is_rare: Bool[np.ndarray, " M"]
    """Which windows are rare; none where that does not matter."""
    rare: Int[np.ndarray, " R"]
    """At which state each rare window begins."""
    skipped: int
    """So many windows were read before the stream was taken up."""


class _Reader:
    """Where in the pools a stream is."""

    def __init__(self, pools: Iterator[Pool]):
        self._pools = pools
        self.pool = next(pools)
        self._at = self.pool.skipped

    def take(
        self, count: int, length: int
    ) -> tuple[Float[np.ndarray, "N F V"], Bool[np.ndarray, " N"]]:
        """Return (the next `count` windows of `length` states, which of them are rare)."""
        windows = []
        is_rare = []
        while count:
            if self._at == len(self.pool.begins):
                self.pool = next(self._pools)
                self._at = self.pool.skipped
            some = slice(self._at, min(self._at + count, len(self.pool.begins)))
            windows.append(windows_at(self.pool.numbers, self.pool.begins[some], length))
            is_rare.append(self.pool.is_rare[some])
            count -= some.stop - some.start
            self._at = some.stop
        if len(windows) == 1:
            return windows[0], is_rare[0]
        return np.concatenate(windows), np.concatenate(is_rare)


def windows_at(
    numbers: Float[np.ndarray, "N V"], begins: Int[np.ndarray, " M"], length: int
) -> Float[np.ndarray, "M L V"]:
    """Return the `length` consecutive rows of `numbers` from each of `begins` on."""
    size = numbers.shape[1]
    row, number = numbers.strides
    shape = (len(numbers) - length + 1, length * size)
    # Rows of a window lie side by side: as one long row they are copied at once.
    windows = np.lib.stride_tricks.as_strided(numbers, shape, (row, number), writeable=False)
    return windows[begins].reshape(len(begins), length, size)
