"""JAX: everything in one program for one core, as somebody would write it who knows JAX."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from benchmarks.super_steps.case import (
    BATCH_STEPS,
    BATCHES,
    GRADIENT,
    GRADIENT_STEPS,
    STEPS,
    SUPER_STEP,
    Case,
    Motion,
    batch_task,
)
from neuroanimator.control.descent.jax_evaluator import JaxEvaluator
from neuroanimator.emulator.super_step import rollout
from neuroanimator.learn.evaluation.speed import compiled

NAME = "JAX"


def cases(motion: Motion) -> Iterator[Case]:
    """Yield the cases of one emulator."""
    emulator = motion.emulator
    start = jnp.asarray(motion.rest)
    one = partial(ready, compiled(emulator, rollout), start, jnp.asarray(motion.controls))
    yield Case(NAME, SUPER_STEP, STEPS, one)
    gradient = partial(JaxEvaluator(motion.problem).gradients, motion.no_control)
    yield Case(NAME, GRADIENT, GRADIENT_STEPS, gradient)
    many = compiled(emulator, jax.vmap(rollout, (None, 0, 0)))
    for batch in BATCHES:
        inputs = [jnp.asarray(array) for array in motion.batch(batch)]
        yield Case(NAME, batch_task(batch), batch * BATCH_STEPS, partial(ready, many, *inputs))


def ready(run: Any, *inputs: Array) -> np.ndarray:
    """Return what `run` returns, when it is there."""
    return run(*inputs).block_until_ready()
