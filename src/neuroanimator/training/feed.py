"""What a training run learns from, chunk by chunk: windows in memory, or a stream of them from disk."""

from __future__ import annotations

import abc
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, final

import jax
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.networks.network import Network
from neuroanimator.training.chunk import (
    Batches,
    TrainingProblem,
    WindowsInMemory,
    train_batches,
    train_chunk,
)
from neuroanimator.training.config import UPDATES_PER_CHUNK
from neuroanimator.training.prefetch import Prefetched
from neuroanimator.training.window_stream import BLOCKS_AHEAD, Block, Demand, WindowStream


class Feed(abc.ABC):
    """The windows of a run, and the updates made of them."""

    @abc.abstractmethod
    def train(
        self, network: Network, optimizer_state: Any, chunk: int
    ) -> tuple[Network, Any, float]:
        """Return (network, optimiser state, mean loss) after chunk number `chunk`: a function of the arguments alone."""

    @abc.abstractmethod
    def close(self) -> None:
        """End what goes on beside the updates."""


@final
@dataclass(frozen=True)
class MemoryFeed(Feed):
    """All windows lie in memory; each batch is drawn among all of them."""

    problem: TrainingProblem
    windows: WindowsInMemory

    def train(
        self, network: Network, optimizer_state: Any, chunk: int
    ) -> tuple[Network, Any, float]:
        network, optimizer_state, loss = train_chunk(
            self.problem,
            self.windows,
            network,
            optimizer_state,
            as_jax(chunk, np.int32),
            self.problem.config.unroll_at(chunk),
        )
        return network, optimizer_state, float(loss)

    def close(self) -> None:
        return None


@final
@dataclass
class StreamFeed(Feed):
    """Windows are read from disk, ahead and in threads; an epoch shows each of them once."""

    problem: TrainingProblem
    stream: WindowStream
    _blocks: Prefetched[Block] | None = None
    _next_chunk: int = field(default=-1)
    """The one that the next block belongs to."""

    def train(
        self, network: Network, optimizer_state: Any, chunk: int
    ) -> tuple[Network, Any, float]:
        if self._blocks is None or self._next_chunk != chunk:
            self.close()
            blocks = self.stream.blocks(self.demands(chunk), self._position(chunk))
            self._blocks = Prefetched(blocks, BLOCKS_AHEAD)
        losses = []
        for demand in self.demands_of(chunk):
            network, optimizer_state, loss = train_batches(
                self.problem,
                self._on_device(next(self._blocks)),
                network,
                optimizer_state,
                as_jax(chunk, np.int32),
                as_jax(demand.first_update, np.int32),
            )
            losses.append(float(loss))
        self._next_chunk = chunk + 1
        return network, optimizer_state, float(np.mean(losses))

    def close(self) -> None:
        if self._blocks is not None:
            self._blocks.close()
            self._blocks = None

    def _position(self, chunk: int) -> int:
        """Return how many windows of the stream the chunks before number `chunk` take."""
        config = self.problem.config
        position = 0
        for number in range(chunk):
            size = config.batch_at(config.unroll_at(number))
            position += UPDATES_PER_CHUNK * self.stream.new_per_batch(size)
        return position

    def demands(self, chunk: int) -> Iterator[Demand]:
        """Yield what blocks are wanted from chunk number `chunk` to the end of the run."""
        for number in range(chunk, self.problem.config.chunks):
            yield from self.demands_of(number)

    def demands_of(self, chunk: int) -> Iterator[Demand]:
        """Yield what blocks a chunk is made of."""
        unroll = self.problem.config.unroll_at(chunk)
        size = self.problem.config.batch_at(unroll)
        updates = self.stream.updates_per_block(UPDATES_PER_CHUNK, size, unroll)
        for first in range(0, UPDATES_PER_CHUNK, updates):
            yield Demand(chunk, first, updates, size, unroll)

    @staticmethod
    def _on_device(block: Block) -> Batches:
        """Return a block as JAX takes it. Nobody writes into its arrays, so they need not be copied."""
        weights = None
        if block.weights is not None:
            weights = _put(block.weights)
        return Batches(_put(block.windows), weights)


def _put(numbers: Float[np.ndarray, " ..."]) -> Float[Array, " ..."]:
    return jax.device_put(numbers)
