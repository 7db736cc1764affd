"""A fresh emulator for a dataset's system and numbers, with an untrained network."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.encoding import Encoding, StateEncoding
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.group_modes import GroupedModes, fit_grouped_modes
from neuroanimator.emulator.mode_fitting import fit_modes
from neuroanimator.emulator.networks import make_network
from neuroanimator.emulator.networks.hierarchy import Part
from neuroanimator.emulator.networks.hierarchy_parts import parts_of_body, parts_of_joints
from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.normaliser import MIN_CHANGE, Normaliser, varies
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.system import System

BLOCK_ROWS = 4096
"""Number of windows whose statistics are computed at once."""

MIN_SCALE = 1e-6
"""Minimum scale of a feature or a change, so that constant numbers are not divided by zero."""

NOTHING_MOVES = (
    f"Nothing in this system changes by {MIN_CHANGE:g} of its unit in a super step. "
    "Use longer super steps (--substeps), smaller units, or stronger controls."
)
"""Error message for a dataset in which no number moves."""

MAX_SHAPES = 20_000
"""Maximum number of states from which the shape modes of a deformable body are computed."""

SHAPES_TRIED = 64
"""Number of states around which the effect of a latent change on the body is measured."""

SMALL_CHANGE = 1e-5
"""Size of these latent changes, in their own units."""


@dataclass(frozen=True)
class _Latent:
    """The latent numbers of a system, and their features for a network."""

    encoding: Encoding
    frame: Frame
    features: Features
    odd_changes: Bool[np.ndarray, " V"]
    """Whether the mirror reverses each number of a change."""
    grouped_modes: GroupedModes | None = None
    """Shape modes and their groups; None if states are not encoded."""


@dataclass(frozen=True)
class _Moments:
    """Mean, spread and range of some numbers, each over all rows."""

    count: int
    mean: Float[np.ndarray, " K"]
    std: Float[np.ndarray, " K"]
    low: Float[np.ndarray, " K"]
    high: Float[np.ndarray, " K"]

    @classmethod
    def of(cls, rows: Float[np.ndarray, "N K"]) -> _Moments:
        mean = rows.mean(axis=0, dtype=float)
        std = rows.std(axis=0, dtype=float)
        return cls(len(rows), mean, std, rows.min(axis=0), rows.max(axis=0))

    def joined(self, other: _Moments) -> _Moments:
        """Return the moments of both together, in double precision (Chan, Golub and LeVeque, 1979)."""
        count = self.count + other.count
        apart = other.mean - self.mean
        mean = self.mean + apart * (other.count / count)
        squares = self.count * self.std**2 + other.count * other.std**2
        squares += apart**2 * (self.count * other.count / count)
        low = np.minimum(self.low, other.low)
        high = np.maximum(self.high, other.high)
        return _Moments(count, mean, np.sqrt(squares / count), low, high)


class _Statistics(NamedTuple):
    """Statistics for normalisers and domains."""

    raw: _Moments
    """Moments of the raw features."""
    change: _Moments
    """Moments of the changes a network predicts."""
    whole_change: _Moments

    @classmethod
    def of(cls, latent: _Latent, data: Transitions) -> _Statistics:
        frame = latent.frame
        states, following, controls = _latent_numbers(latent.encoding, data)
        local = frame.local(states)
        felt = frame.felt_control(states, controls)
        return cls(
            raw=_Moments.of(latent.features.plain_of(states, local, felt)),
            change=_Moments.of(frame.remainder(states, following)),
            whole_change=_Moments.of(frame.difference(states, following)),
        )

    def joined(self, other: _Statistics) -> _Statistics:
        return _Statistics(*map(_Moments.joined, self, other))


def _latent_numbers(
    encoding: Encoding, data: Transitions
) -> tuple[Float[np.ndarray, "N I"], Float[np.ndarray, "N I"], Float[np.ndarray, "N C"]]:
    """Return (latent states, latent states a super step later, latent controls between them)."""
    if encoding.is_identity:
        return data.states[:, 0], data.states[:, 1], data.controls[:, 0]
    states = encoding.encode(np.asarray(data.states[:, :2], float))
    controls = encoding.encode_control(np.asarray(data.controls[:, 0], float))
    return states[:, 0], states[:, 1], controls


def build_emulator(
    data: Transitions, config: TrainingConfig, parts: Iterable[Transitions] | None = None
) -> Emulator:
    """Return an emulator normalised by `data`, its network drawn from the config's seed.

    If the data do not fit into memory, `data` is a sample of them, from which shape modes are computed; means, spreads and
    ranges are those of all data, whose `parts` come one after another.
    """
    system = data.system
    dt = data.config.substeps * system.physics_dt
    latent = _latent_of(data, config, dt)
    features = latent.features
    of_blocks = (
        _Statistics.of(latent, block) for part in parts or [data] for block in _blocks_of(part)
    )
    statistics = reduce(_Statistics.joined, of_blocks)
    size = len(statistics.raw.mean)
    odd_raw = np.full(size, features.is_odd)
    odd_raw[list(features.even)] = False
    return Emulator(
        frame=latent.frame,
        features=features,
        normaliser=_normaliser(data, latent, statistics, odd_raw),
        network=_network(config, latent, system, size),
        domain=_domain(statistics.raw, odd_raw, features, system),
        spec=spec_of(system, data.config.substeps, latent.frame.dt),
        encoding=latent.encoding,
    )


def _blocks_of(data: Transitions) -> Iterator[Transitions]:
    """Yield `data` block by block: features of all at once would take many times the memory."""
    for first in range(0, len(data.states), BLOCK_ROWS):
        yield data.where(slice(first, first + BLOCK_ROWS))


def _latent_of(data: Transitions, config: TrainingConfig, dt: float) -> _Latent:
    """Return the numbers that super steps advance: the state's own, or those of a deformable body's shape modes."""
    system = data.system
    structure = system.structure
    partners = structure.mirror.controls if structure.swimmer and structure.mirror else ()
    encoding: Encoding = StateEncoding(system.state, partners)
    grouped = None
    if structure.cloud is not None:
        grouped = _fit_modes(data, config)
        encoding = grouped.modes
        structure = grouped.modes.structure(structure)
    size = encoding.layout.size
    frame = Frame.of(structure, dt)
    features = Features.of(structure, size, dt)
    odd_changes = np.full(frame.change_size(size), features.is_odd)
    if encoding.is_mirrored:
        odd_features = encoding.odd_features(system.structure)
        even = tuple(i for i, is_odd in enumerate(odd_features) if not is_odd)
        features = replace(features, is_odd=True, even=even)
        odd_changes = np.array(encoding.odd_changes(system.structure))
    return _Latent(encoding, frame, features, odd_changes, grouped)


def _fit_modes(data: Transitions, config: TrainingConfig) -> GroupedModes:
    """Return the shape modes of the bodies in `data`, in groups for a hierarchy."""
    rng = np.random.default_rng(config.seed)
    count = min(len(data.states), MAX_SHAPES)
    rows = np.sort(rng.choice(len(data.states), count, replace=False))
    structure = data.system.structure
    states = data.states[rows, 0]
    if config.network == "hierarchy":
        return fit_grouped_modes(structure, states, config.local_modes)
    modes = fit_modes(structure, states, config.position_modes, config.velocity_modes)
    return GroupedModes(modes, [], [])


def _network(config: TrainingConfig, latent: _Latent, system: System, count: int) -> Network:
    """Return a fresh network for `count` raw features."""
    features = latent.features
    even_changes = ()
    if features.even:
        even_changes = tuple(int(i) for i in np.flatnonzero(~latent.odd_changes))
    parts = ()
    if config.network == "hierarchy":
        parts = _parts(latent, system, count)
    odd_size, even_size = features.sizes(count - len(features.plain))
    return make_network(
        _network_name(config, features),
        odd_size,
        even_size,
        len(latent.odd_changes),
        config.widths,
        jax.random.key(config.seed),
        even_changes,
        parts,
        gates_even=bool(system.parameters),
    )


def _parts(latent: _Latent, system: System, count: int) -> tuple[Part, ...]:
    """Return the inputs and outputs of each part of a hierarchy with `count` raw features."""
    structure = system.structure
    if not structure.groups:
        raise ArgumentError(
            f"network: {system.name} has no [groups], which a hierarchy needs. Name its segments."
        )
    if latent.grouped_modes is None:
        return parts_of_joints(structure, latent.frame, latent.features, system.control.size)
    return parts_of_body(latent.grouped_modes, structure, latent.features.even, count)


def _network_name(config: TrainingConfig, features: Features) -> str:
    """Return the requested network, or the variant of `gated` for another mirror symmetry or none."""
    if config.network != "gated":
        return config.network
    if features.even:
        return "mirrored"
    return "gated" if features.is_odd else "glu"


def spec_of(system: System, substeps: int, dt: float) -> EmulatorSpec:
    """Return the facts of an emulator of `system` that leaps `substeps` physics steps, `dt` [s], at a time."""
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
        definition=system.definition_text,
        is_tied=system.is_tied,
        engine=system.engine,
        gait=system.gait,
    )


def _domain(
    raw: _Moments, odd: Bool[np.ndarray, " K"], features: Features, system: System
) -> Domain:
    """Return the range of the raw features, symmetric for those the mirror reverses.

    Parameters have their whole ranges, most of which runs have shown.
    """
    high = np.where(odd, np.maximum(-raw.low, raw.high), raw.high)
    low = np.where(odd, -high, raw.low)
    last = features.angles.shape[1]  # of a state or a latent state
    for place, parameter in enumerate(reversed(system.parameters), start=1):
        shown = features.plain.index(last - place)
        low[shown] = parameter.low
        high[shown] = parameter.high
    return Domain(as_jax(low), as_jax(high))


def _normaliser(
    data: Transitions,
    latent: _Latent,
    statistics: _Statistics,
    odd_raw: Bool[np.ndarray, " K"],
) -> Normaliser:
    """Return the normaliser of raw features and changes; those the mirror reverses have a mean of zero."""
    raw = statistics.raw
    change = statistics.change
    whole_change = statistics.whole_change
    change_scale = np.maximum(change.std, MIN_SCALE)
    unit = np.maximum(whole_change.std, MIN_SCALE)
    if latent.encoding.keeps_entries:
        mean = np.where(latent.odd_changes, 0.0, whole_change.mean)
        is_varied = varies(mean, whole_change.std)
        if not is_varied.any():
            raise ArgumentError(NOTHING_MOVES)
        change_scale = np.where(is_varied, change_scale, 0.0)
        unit = data.system.structure.common_scale(np.where(is_varied, unit, 0.0))
    else:  # all latent numbers of a deformable body move, and have their own units
        unit = _body_units(data, latent)
    plain_mean = np.where(odd_raw, 0.0, raw.mean)
    plain_scale = np.maximum(raw.std, MIN_SCALE)
    change_mean = np.where(latent.odd_changes, 0.0, change.mean)
    return Normaliser(
        plain_mean=as_jax(plain_mean),
        plain_scale=as_jax(plain_scale),
        change_mean=as_jax(change_mean),
        change_scale=as_jax(change_scale),
        unit=as_jax(unit),
    )


def _body_units(data: Transitions, latent: _Latent) -> Float[np.ndarray, " V"]:
    """Return the errors of the numbers of a change that have equal effects on the body's whole state.

    Errors of modes are measured by their effect on all mass points, from small changes of some states.
    """
    body = Frame.of(data.system.structure, 0.0)
    frame = replace(latent.frame, dt=0.0)
    before = np.asarray(data.states[:MAX_SHAPES, 0], float)
    after = np.asarray(data.states[:MAX_SHAPES, 1], float)
    scale = np.maximum(body.difference(before, after).std(axis=0), MIN_SCALE)
    every = max(1, len(data.states) // SHAPES_TRIED)
    tried = latent.encoding.encode(np.asarray(data.states[::every, 0], float))
    states = latent.encoding.decode(tried)
    units = []
    for change in np.eye(len(latent.odd_changes)) * SMALL_CHANGE:
        moved = frame.apply(tried, np.broadcast_to(change, (len(tried), len(change))))
        difference = body.difference(states, latent.encoding.decode(moved))
        effect = np.sqrt(np.mean((difference / scale) ** 2)) / SMALL_CHANGE
        units.append(1 / max(effect, MIN_SCALE))
    return np.array(units) / np.sqrt(len(units))
