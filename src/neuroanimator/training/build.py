"""A fresh emulator that fits a dataset's system and numbers, its network untrained."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.data.transitions import Transitions
from neuroanimator.emulator.emulator import Domain, Emulator, Identity
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.network import make_network
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.training.config import TrainingConfig

SMALLEST_SCALE = 1e-6
"""A number that never varies is divided by this share of one instead of by zero."""


def build_emulator(data: Transitions, config: TrainingConfig) -> Emulator:
    """Return an emulator normalised by `data`, its network drawn from the config's seed."""
    system = data.system
    dt = data.config.substeps * system.physics_dt
    features = Features.of(system.structure, system.state.size, dt)
    plain = np.concatenate([data.states[:, 0][:, np.array(features.plain, dtype=int)], data.controls[:, 0]], axis=1)
    sizes = features.sizes(system.control.size)
    network = make_network(config.network, *sizes, system.state.size, config.widths, jax.random.key(config.seed))
    return Emulator(
        features=features,
        normaliser=_normaliser(plain, data.states[:, 1] - data.states[:, 0], features.is_odd),
        network=network,
        domain=Domain(jnp.asarray(plain.min(axis=0)), jnp.asarray(plain.max(axis=0))),
        identity=Identity(
            system=system.name,
            state=system.state,
            control=system.control,
            control_limit=tuple(float(limit) for limit in system.control_limit),
            substeps=data.config.substeps,
            dt=dt,
            skeleton=system.skeleton,
            rates=system.structure.rates,
        ),
    )


def _normaliser(plain: np.ndarray, change: np.ndarray, is_odd: bool) -> Normaliser:
    means = [np.zeros(values.shape[1]) if is_odd else values.mean(axis=0) for values in (plain, change)]
    scales = [np.maximum(values.std(axis=0), SMALLEST_SCALE) for values in (plain, change)]
    numbers = [jnp.asarray(value, jnp.float32) for value in (means[0], scales[0], means[1], scales[1])]
    return Normaliser(*numbers)
