"""The windows of a training run, pool by pool, and the updates on them."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any, final

import scipy.linalg  # noqa: F401  what JAX's decompositions call must be loaded before its threads can be limited
from threadpoolctl import threadpool_limits

from neuroanimator.emulator.networks.network import Network
from neuroanimator.learn.training.chunk import (
    RunPosition,
    TrainingProblem,
    WindowsInMemory,
    train_chunk,
)
from neuroanimator.learn.training.pools import Pools


@final
@dataclass
class Feed:
    """Trains chunk by chunk, each on windows of its pool; the next pool is read and encoded ahead, in a thread."""

    problem: TrainingProblem
    pools: Pools
    _reader: ThreadPoolExecutor = field(default_factory=partial(ThreadPoolExecutor, 1))
    _unread: Iterator[WindowsInMemory] | None = None
    """The pools after the next one."""
    _next: Future[WindowsInMemory] | None = None
    _pool: WindowsInMemory | None = None
    _number: int = -1
    """Number of the pool in memory."""

    def train(
        self, network: Network, optimizer_state: Any, chunk: int
    ) -> tuple[Network, Any, float]:
        """Return (network, optimiser state, mean loss) after chunk number `chunk`: a function of the arguments alone."""
        config = self.problem.config
        pool = self._pool_at(int(self.pools.of_chunks[chunk]))
        position = RunPosition.of(config, chunk)
        # One thread of BLAS: SOAP's decompositions wake the others, which then spin between updates, on the cores of XLA.
        with threadpool_limits(1, "blas"):
            network, optimizer_state, loss = train_chunk(
                self.problem.of_any_run,
                pool,
                network,
                optimizer_state,
                position,
                config.unroll_at(chunk),
            )
            return network, optimizer_state, float(loss)

    def _pool_at(self, number: int) -> WindowsInMemory:
        if self._pool is not None and number == self._number:
            return self._pool
        if self._next is None or self._unread is None or number != self._number + 1:
            self._unread = self.pools.pools(number)
            self._next = self._reader.submit(next, self._unread)
        self._pool = self._next.result()
        self._number = number
        # No more than one: each may take as much memory as the user allows.
        self._next = self._reader.submit(next, self._unread)
        return self._pool

    def close(self) -> None:
        """Free the pools in memory, and end the thread that reads them."""
        self._reader.shutdown(cancel_futures=True)
        self._next = None
        self._pool = None
