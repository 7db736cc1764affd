"""The optimisers of training: SOAP, Adam, and gradient descent with momentum."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import optax
from jaxtyping import Array, Int

from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.soap import scale_by_soap

MAX_GRADIENT = 1.0
"""Norm to which gradients are clipped: a rare wild batch must not undo hours of training."""

MOMENTUM = 0.9
"""Momentum of gradient descent, as in 1998."""

ADAM_DECAY = 0.99
"""Decay rate of Adam's mean square gradient (β₂)."""

MAX_WARMUP = 500
"""Maximum number of updates of warm-up; a tenth of short runs."""


def make_optimizer(
    config: TrainingConfig, updates: int | Int[Array, ""] | None = None
) -> optax.GradientTransformation:
    """Return the optimiser, whose learning rate rises, then falls to zero along a cosine.

    `updates` are those of the whole run, by default the configuration's; an array compiles once for any number.
    """
    total = config.whole_updates if updates is None else updates

    def rate(count: Any) -> Any:
        warmup = jnp.clip(total // 10, 1, MAX_WARMUP)
        fall = jnp.cos(jnp.pi * (count - warmup) / (total - warmup))
        share = jnp.where(count < warmup, count / warmup, (1 + fall) / 2)
        return config.learning_rate * share

    optimizers = {
        "soap": optax.chain(scale_by_soap(), optax.scale_by_learning_rate(rate)),
        "adam": optax.adam(rate, b2=ADAM_DECAY),
        "momentum": optax.sgd(rate, momentum=MOMENTUM),
    }
    return clipped(optimizers[config.optimizer])


def clipped(optimizer: optax.GradientTransformation) -> optax.GradientTransformation:
    """Return the optimiser, for gradients clipped to `MAX_GRADIENT`."""
    return optax.chain(optax.clip_by_global_norm(MAX_GRADIENT), optimizer)
