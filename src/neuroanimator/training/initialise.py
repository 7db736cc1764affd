"""A fresh emulator that fits a dataset's system and numbers, its network untrained."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator.data.store import Transitions
from neuroanimator.emulator.emulator import Domain, Emulator, EmulatorSpec
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.group_modes import GroupedModes, fit_grouped_modes
from neuroanimator.emulator.networks import make_network
from neuroanimator.emulator.networks.hierarchy import Part
from neuroanimator.emulator.networks.hierarchy_parts import parts_of_body, parts_of_joints
from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.normaliser import MIN_CHANGE, Normaliser
from neuroanimator.emulator.shape_modes import Modes, fit_modes
from neuroanimator.errors import ArgumentError
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.system import System
from neuroanimator.training.config import TrainingConfig

MIN_SCALE = 1e-6
"""A number that never varies is divided by this share of one instead of by zero."""

NOTHING_MOVES = (
    f"Nothing in this system changes by {MIN_CHANGE:g} of its unit in a super step. "
    "Use longer super steps (--substeps), smaller units, or stronger controls."
)

MAX_SHAPES = 20_000
"""States whose shapes the modes of a deformable body are found from."""

SHAPES_TRIED, SMALL_CHANGE = 64, 1e-5
"""States around which, and changes by which, the effect of a body's few numbers is measured."""


class _Sight(NamedTuple):
    """How states are seen, before any network."""

    modes: GroupedModes | None
    frame: Frame
    features: Features
    odd_changes: np.ndarray
    """(V,) whether the mirror reverses each number of a change."""
    latent: tuple[np.ndarray, np.ndarray, np.ndarray]
    """States, following states and controls in the numbers in which the super step is made."""


def build_emulator(data: Transitions, config: TrainingConfig) -> Emulator:
    """Return an emulator normalised by `data`, its network drawn from the config's seed."""
    system, sight = data.system, _sight(data, config)
    states, _, controls = sight.latent
    features, frame = sight.features, sight.frame
    plain = features.plain_of(states, frame.local(states), frame.seen_control(states, controls))
    odd_plain = np.array(
        [features.is_odd and i not in features.even for i in range(plain.shape[1])]
    )
    normaliser = _normaliser(plain, sight, odd_plain)
    modes = None if sight.modes is None else sight.modes.modes
    if modes is not None:
        normaliser = replace(normaliser, unit=_body_units(modes, data, sight))
    return Emulator(
        frame=frame,
        features=features,
        normaliser=normaliser,
        network=_network(config, sight, system, plain.shape[1]),
        domain=_domain(plain, odd_plain),
        spec=_spec(system, data.config.substeps, frame.dt),
        modes=modes,
    )


def _sight(data: Transitions, config: TrainingConfig) -> _Sight:
    system = data.system
    dt = data.config.substeps * system.physics_dt
    states, controls = data.states[:, :2], data.controls[:, 0]
    if system.structure.cloud is None:
        frame, features = (
            Frame.of(system.structure, dt),
            Features.of(system.structure, states.shape[-1], dt),
        )
        odd = np.full(frame.change_size(states.shape[-1]), features.is_odd)
        return _Sight(None, frame, features, odd, (states[:, 0], states[:, 1], controls))
    grouped = _modes(data, config)
    modes, structure = grouped.modes, grouped.modes.structure(system.structure)
    states, controls = (
        modes.encode(np.asarray(states, float)),
        modes.encode_control(np.asarray(controls, float)),
    )
    frame, features = Frame.of(structure, dt), Features.of(structure, states.shape[-1], dt)
    odd = np.zeros(frame.change_size(states.shape[-1]), bool)
    if modes.mirror is not None:
        is_odd = modes.odd_features(system.structure, 4 * len(structure.probes))
        features = replace(
            features, is_odd=True, even=tuple(i for i, each in enumerate(is_odd) if not each)
        )
        odd = np.array(modes.odd_changes())
    return _Sight(grouped, frame, features, odd, (states[:, 0], states[:, 1], controls))


def _network(config: TrainingConfig, sight: _Sight, system: System, numbers: int) -> Network:
    features = sight.features
    even = tuple(int(i) for i in np.flatnonzero(~sight.odd_changes)) if features.even else ()
    sizes = (*features.sizes(numbers - len(features.plain)), len(sight.odd_changes))
    parts = _parts(sight, system, numbers) if config.network == "hierarchy" else ()
    return make_network(
        _kind(config, features), *sizes, config.widths, jax.random.key(config.seed), even, parts
    )


def _parts(sight: _Sight, system: System, numbers: int) -> tuple[Part, ...]:
    """Return who sees and answers what in a hierarchy."""
    if not system.structure.groups:
        raise ArgumentError(
            f"network: {system.name} has no [groups], which a hierarchy needs. Name its segments."
        )
    if sight.modes is None:
        return parts_of_joints(system.structure, sight.frame, sight.features, system.control.size)
    return parts_of_body(sight.modes, system.structure, sight.features.even, numbers)


def _kind(config: TrainingConfig, features: Features) -> str:
    """Return the network asked for, or what stands for `gated` where the mirror is another or there is none."""
    if config.network != "gated":
        return config.network
    return "mirrored" if features.even else "gated" if features.is_odd else "glu"


def _modes(data: Transitions, config: TrainingConfig) -> GroupedModes:
    rng = np.random.default_rng(config.seed)
    rows = np.sort(rng.choice(len(data.states), min(len(data.states), MAX_SHAPES), replace=False))
    structure, states = data.system.structure, data.states[rows, 0]
    if config.network == "hierarchy":
        return fit_grouped_modes(structure, states, config.local_modes)
    return GroupedModes(
        fit_modes(structure, states, config.position_modes, config.velocity_modes), [], []
    )


def _body_units(modes: Modes, data: Transitions, sight: _Sight) -> jax.Array:
    """Return (V,) the error of each number of a change that costs as much as any other in the body's whole state.

    Errors of modes are measured by what they do to all mass points, found by small changes of some states.
    """
    latent, body = sight.latent[0], Frame.of(data.system.structure, 0.0)
    frame = replace(sight.frame, dt=0.0)
    few = latent[:: max(1, len(latent) // SHAPES_TRIED)]
    before, after = np.moveaxis(np.asarray(data.states[:MAX_SHAPES, :2], float), 1, 0)
    scale = np.maximum(body.difference(before, after).std(axis=0), MIN_SCALE)
    positions, units = modes.decode(few), []
    for way in np.eye(len(sight.odd_changes)) * SMALL_CHANGE:
        moved = body.difference(
            positions, modes.decode(frame.apply(few, np.broadcast_to(way, (len(few), len(way)))))
        )
        effect = np.sqrt(np.mean((moved / scale) ** 2)) / SMALL_CHANGE
        units.append(1 / max(effect, MIN_SCALE))
    return jnp.asarray(np.array(units) / np.sqrt(len(units)), jnp.float32)


def _spec(system: System, substeps: int, dt: float) -> EmulatorSpec:
    return EmulatorSpec(
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


def _normaliser(plain: np.ndarray, sight: _Sight, odd_plain: np.ndarray) -> Normaliser:
    """Return the normaliser of plain features and changes; what the mirror reverses has a mean of zero."""
    states, following, _ = sight.latent
    change, whole = (
        sight.frame.remainder(states, following),
        sight.frame.difference(states, following),
    )
    pairs = (plain, odd_plain), (change, sight.odd_changes)
    means = [np.where(odd, 0.0, values.mean(axis=0)) for values, odd in pairs]
    scales = [np.maximum(values.std(axis=0), MIN_SCALE) for values in (plain, change, whole)]
    if (
        sight.modes is None
    ):  # the few numbers of a deformable body all move, and have units of their own
        moves = whole.std(axis=0) >= MIN_CHANGE
        if not moves.any():
            raise ArgumentError(NOTHING_MOVES)
        scales[1] = np.where(moves, scales[1], 0.0)
        scales[2] = np.where(moves, scales[2], 0.0)
    numbers = [
        jnp.asarray(value, jnp.float32)
        for value in (means[0], scales[0], means[1], scales[1], scales[2])
    ]
    return Normaliser(*numbers)
