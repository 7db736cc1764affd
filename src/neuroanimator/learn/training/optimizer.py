"""The optimisers of training: SOAP, Adam, and gradient descent with momentum."""

from __future__ import annotations

import optax

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


def make_optimizer(config: TrainingConfig) -> optax.GradientTransformation:
    """Return the optimiser with a cosine decay of the learning rate to zero."""
    total = config.whole_updates
    warmup = min(MAX_WARMUP, total // 10)
    rate = optax.warmup_cosine_decay_schedule(0.0, config.learning_rate, warmup, total)
    optimizers = {
        "soap": optax.chain(scale_by_soap(), optax.scale_by_learning_rate(rate)),
        "adam": optax.adam(rate, b2=ADAM_DECAY),
        "momentum": optax.sgd(rate, momentum=MOMENTUM),
    }
    return optax.chain(optax.clip_by_global_norm(MAX_GRADIENT), optimizers[config.optimizer])
