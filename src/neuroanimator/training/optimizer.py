"""The three ways down."""

from __future__ import annotations

import optax
from optax import contrib

from neuroanimator.training.config import UPDATES_PER_CHUNK, TrainingConfig

MAX_GRADIENT = 1.0
"""Gradients are clipped to this norm; a rare wild batch must not undo hours of training."""

MOMENTUM = 0.9


def make_optimizer(config: TrainingConfig) -> optax.GradientTransformation:
    """Return the optimiser with a learning rate that falls to zero along a cosine."""
    total = config.chunks * UPDATES_PER_CHUNK
    rate = optax.warmup_cosine_decay_schedule(
        0.0, config.learning_rate, min(500, total // 10), total
    )
    makers = {
        "muon": lambda: contrib.muon(rate, adam_learning_rate=rate),
        "adam": lambda: optax.adam(rate, b2=0.99),
        "momentum": lambda: optax.sgd(rate, momentum=MOMENTUM),
    }
    return optax.chain(optax.clip_by_global_norm(MAX_GRADIENT), makers[config.optimizer]())
