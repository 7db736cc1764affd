"""How long one chunk of training updates takes."""

from __future__ import annotations

import time

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.learn.training.checkpoint import TrainingState
from neuroanimator.learn.training.chunk import (
    RunPosition,
    TrainingProblem,
    WindowsInMemory,
    train_chunk,
)
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.optimizer import make_optimizer
from neuroanimator.state.structure import Structure

WINDOWS = 1024
"""Made-up windows the updates learn from."""

RARE_WINDOWS = 64
"""How many of them count as rare."""

SPREAD = 1e-3
"""Standard deviation of their states about rest, in their own units."""

CHUNKS = 3
"""Chunks that are timed; the first one, which compiles, does not count."""


def time_chunk(emulator: Emulator, config: TrainingConfig) -> float:
    """Return how long one chunk of single-step updates takes here [s], compilation excluded."""
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(WINDOWS, 2, emulator.state.size)).astype(np.float32)
    rest = jnp.asarray(emulator.rest, jnp.float32)
    middle = jnp.asarray(emulator.bounds.middle, jnp.float32)
    problem = TrainingProblem(
        config=config,
        structure=Structure((), (), ()),
        symmetries=(),
        base=emulator,
        rest=None,
    )
    windows = WindowsInMemory(
        states=emulator.encode(rest + SPREAD * noise),
        controls=jnp.tile(middle, (WINDOWS, 1, 1)),
        rare=jnp.arange(RARE_WINDOWS),
        count=jnp.array(WINDOWS),
    )
    fresh = TrainingState.fresh(emulator.network, make_optimizer(config))
    spans = []
    for chunk in range(CHUNKS):
        began = time.perf_counter()
        position = RunPosition.of(config, chunk)
        after = train_chunk(problem, windows, fresh.network, fresh.optimizer_state, position, 1)
        jax.block_until_ready(after)
        spans.append(time.perf_counter() - began)
    return min(spans[1:])
