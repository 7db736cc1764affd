"""The optimisers of training: Muon, Adam, and gradient descent with momentum."""

from __future__ import annotations

from typing import Any

import jax
import optax
from optax import contrib

from neuroanimator.learn.training.config import TrainingConfig

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
        "muon": contrib.muon(
            rate,
            ns_steps=config.orthogonalisation_steps,
            adam_learning_rate=rate,
            muon_weight_dimension_numbers=matrices_of,
        ),
        "adam": optax.adam(rate, b2=ADAM_DECAY),
        "momentum": optax.sgd(rate, momentum=MOMENTUM),
    }
    return optax.chain(optax.clip_by_global_norm(MAX_GRADIENT), optimizers[config.optimizer])


def matrices_of(network: Any) -> Any:
    """Return which of a network's weights Muon orthogonalises: its matrices, except those without rows."""

    # Without a mirror a network has no even inputs, and Muon would divide by their number.
    def dimensions(weights: Any) -> contrib.MuonDimensionNumbers | None:
        if weights.ndim != 2 or not weights.size:
            return None
        return contrib.MuonDimensionNumbers()

    return jax.tree.map(dimensions, network)
