"""A fresh emulator that fits a dataset's system and numbers, its network untrained."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.data.transitions import Transitions
from neuroanimator.emulator.emulator import Domain, Emulator, Identity
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.frame import Frame
from neuroanimator.emulator.network import make_network
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.systems.system import System
from neuroanimator.training.config import TrainingConfig

SMALLEST_SCALE = 1e-6
"""A number that never varies is divided by this share of one instead of by zero."""


def build_emulator(data: Transitions, config: TrainingConfig) -> Emulator:
    """Return an emulator normalised by `data`, its network drawn from the config's seed."""
    system = data.system
    dt = data.config.substeps * system.physics_dt
    structure, size = system.structure, system.state.size
    frame = Frame.of(structure, dt)
    features = Features.of(structure, size, dt)
    states, following = data.states[:, 0], data.states[:, 1]
    plain = features.plain_of(states, frame.local(states), data.controls[:, 0])
    kind = "glu" if config.network == "gated" and not features.is_odd else config.network
    sizes = features.sizes(frame.local_size + system.control.size)
    key = jax.random.key(config.seed)
    return Emulator(
        frame=frame,
        features=features,
        normaliser=_normaliser(plain, frame, states, following, features.is_odd),
        network=make_network(kind, *sizes, frame.change_size(size), config.widths, key),
        domain=_domain(plain, features.is_odd),
        identity=_identity(system, data.config.substeps, dt),
    )


def _identity(system: System, substeps: int, dt: float) -> Identity:
    return Identity(
        system=system.name,
        state=system.state,
        control=system.control,
        bounds=system.bounds,
        substeps=substeps,
        dt=dt,
        skeleton=system.skeleton,
        rates=system.structure.rates,
        rest=tuple(float(value) for value in system.rest),
        definition=system.definition,
    )


def _domain(plain: np.ndarray, is_odd: bool) -> Domain:
    """Return the range of the plain features, the same on both sides where the motion has a mirror."""
    low, high = plain.min(axis=0), plain.max(axis=0)
    if is_odd:
        high = np.maximum(-low, high)
        low = -high
    return Domain(jnp.asarray(low, jnp.float32), jnp.asarray(high, jnp.float32))


def _normaliser(plain: np.ndarray, frame: Frame, states: np.ndarray, following: np.ndarray, is_odd: bool) -> Normaliser:
    change, whole = frame.remainder(states, following), frame.difference(states, following)
    means = [np.zeros(values.shape[1]) if is_odd else values.mean(axis=0) for values in (plain, change)]
    scales = [np.maximum(values.std(axis=0), SMALLEST_SCALE) for values in (plain, change, whole)]
    numbers = [jnp.asarray(value, jnp.float32) for value in (means[0], scales[0], means[1], scales[1], scales[2])]
    return Normaliser(*numbers)
