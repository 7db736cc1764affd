"""A fresh emulator that fits a dataset's system and numbers, its network untrained."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.data.transitions import Transitions
from neuroanimator.emulator.emulator import Domain, Emulator, Identity
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.frame import Frame
from neuroanimator.emulator.modes import Modes, fit_modes
from neuroanimator.emulator.network import make_network
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.systems.structure import Structure
from neuroanimator.systems.system import System
from neuroanimator.training.config import TrainingConfig

SMALLEST_SCALE = 1e-6
"""A number that never varies is divided by this share of one instead of by zero."""

MOST_SHAPES = 20_000
"""States whose shapes the modes of a deformable body are found from."""

SHAPES_TRIED, SMALL_CHANGE = 64, 1e-5
"""States around which, and changes by which, the effect of a body's few numbers is measured."""


def build_emulator(data: Transitions, config: TrainingConfig) -> Emulator:
    """Return an emulator normalised by `data`, its network drawn from the config's seed."""
    system = data.system
    dt = data.config.substeps * system.physics_dt
    modes = _modes(data, config)
    structure = system.structure if modes is None else modes.structure(system.structure)
    windows = data.states[:, :2], data.controls[:, 0]
    if modes is not None:
        windows = modes.encode(np.asarray(windows[0], float)), modes.encode_control(np.asarray(windows[1], float))
    (states, following), controls = np.moveaxis(windows[0], 1, 0), windows[1]
    frame, size = Frame.of(structure, dt), states.shape[1]
    features = Features.of(structure, size, dt)
    odd_changes = np.full(frame.change_size(size), features.is_odd)
    if modes is not None and modes.mirror is not None:
        odd = modes.odd_features(system.structure, 4 * len(structure.probes))
        even = tuple(i for i, is_odd in enumerate(odd) if not is_odd)
        features, odd_changes = replace(features, is_odd=True, even=even), np.array(modes.odd_changes())
    plain = features.plain_of(states, frame.local(states), controls)
    odd_plain = np.array([features.is_odd and i not in features.even for i in range(plain.shape[1])])
    normaliser = _normaliser(plain, frame, states, following, odd_plain, odd_changes)
    if modes is not None:
        normaliser = replace(normaliser, unit=_body_units(modes, system.structure, structure, data.states, states))
    sizes = features.sizes(frame.local_size + system.control.size)
    even_out = tuple(int(i) for i in np.flatnonzero(~odd_changes))
    network = make_network(
        _kind(config, features), *sizes, len(odd_changes), config.widths, jax.random.key(config.seed), even_out
    )
    return Emulator(
        frame=frame,
        features=features,
        normaliser=normaliser,
        network=network,
        domain=_domain(plain, odd_plain),
        identity=_identity(system, data.config.substeps, dt),
        modes=modes,
    )


def _kind(config: TrainingConfig, features: Features) -> str:
    """Return the network asked for, or what stands for `gated` where the mirror is another or there is none."""
    if config.network != "gated":
        return config.network
    return "mirrored" if features.even else "gated" if features.is_odd else "glu"


def _modes(data: Transitions, config: TrainingConfig) -> Modes | None:
    if data.system.structure.cloud is None:
        return None
    rows = np.random.default_rng(config.seed).choice(
        len(data.states), min(len(data.states), MOST_SHAPES), replace=False
    )
    return fit_modes(data.system.structure, data.states[np.sort(rows), 0], config.place_modes, config.speed_modes)


def _body_units(
    modes: Modes, whole: Structure, structure: Structure, states: np.ndarray, inner: np.ndarray
) -> jax.Array:
    """Return (V,) the error of each number of a change that costs as much as any other in the body's whole state.

    Errors of modes are measured by what they do to all mass points, found by small changes of some states.
    """
    frame, body = Frame.of(structure, 0.0), Frame.of(whole, 0.0)
    few = inner[:: max(1, len(inner) // SHAPES_TRIED)]
    scale = np.maximum(
        body.difference(*np.moveaxis(np.asarray(states[:MOST_SHAPES, :2], float), 1, 0)).std(axis=0), SMALLEST_SCALE
    )
    before, units = modes.decode(few), []
    for way in np.eye(frame.change_size(inner.shape[1])) * SMALL_CHANGE:
        moved = body.difference(before, modes.decode(frame.apply(few, np.broadcast_to(way, (len(few), len(way))))))
        units.append(SMALL_CHANGE / np.sqrt(np.mean((moved / scale) ** 2)))
    return jnp.asarray(np.array(units) / np.sqrt(len(units)), jnp.float32)


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
        gait=system.gait,
    )


def _domain(plain: np.ndarray, odd: np.ndarray) -> Domain:
    """Return the range of the plain features, the same on both sides for those the mirror reverses."""
    low, high = plain.min(axis=0), plain.max(axis=0)
    high = np.where(odd, np.maximum(-low, high), high)
    low = np.where(odd, -high, low)
    return Domain(jnp.asarray(low, jnp.float32), jnp.asarray(high, jnp.float32))


def _normaliser(
    plain: np.ndarray,
    frame: Frame,
    states: np.ndarray,
    following: np.ndarray,
    odd_plain: np.ndarray,
    odd_changes: np.ndarray,
) -> Normaliser:
    """Return the normaliser of plain features and changes; what the mirror reverses has a mean of zero."""
    change, whole = frame.remainder(states, following), frame.difference(states, following)
    means = [np.where(odd, 0.0, values.mean(axis=0)) for values, odd in ((plain, odd_plain), (change, odd_changes))]
    scales = [np.maximum(values.std(axis=0), SMALLEST_SCALE) for values in (plain, change, whole)]
    numbers = [jnp.asarray(value, jnp.float32) for value in (means[0], scales[0], means[1], scales[1], scales[2])]
    return Normaliser(*numbers)
