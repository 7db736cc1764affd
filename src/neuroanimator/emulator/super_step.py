"""The definition of a super step in JAX: frame → features → normaliser → network → the state after it."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.encoding import KEPT_MARGIN, Encoding
from neuroanimator.emulator.error_bounds import ErrorBounds
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.networks.network import Network, Units
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.emulator.origin import NOWHERE, Axes, LocatedLatent, Origin, two_sum
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.emulator.trust import TrustMeter
from neuroanimator.emulator.verdict import ValidationErrors
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout, Pairs
from neuroanimator.state.parameters import Parameter
from neuroanimator.state.segments import Constant, place_segments
from neuroanimator.state.structure import Structure

UNROLL = 4
"""Number of super steps compiled into one loop body: 10 % faster than one; eight gain nothing more."""


class SuperStep(eqx.Module):
    """A super step s + change(s, u) (SIGGRAPH 98, eq. 7) as JAX computes it; `Emulator` adds the calls from Python."""

    frame: Frame
    features: Features
    normaliser: Normaliser
    network: Network
    domain: Domain
    spec: EmulatorSpec
    encoding: Encoding
    """Map to the latent state in which super steps are computed."""
    meter: TrustMeter | None = None
    """Meter of an input's distance from training; None in older files."""
    calibration: ErrorBounds | None = None
    """Error bounds of rollouts; None if not measured: see `error_bounds`."""
    validation: ValidationErrors | None = None
    """Errors of one super step within training; None in older files."""

    # Equinox turns every method looked up into a pytree, which takes tens of microseconds and cannot be hashed by `jax.jit`.
    __getattribute__ = object.__getattribute__

    @property
    def system(self) -> str:
        """Name of the system."""
        return self.spec.system

    @property
    def state(self) -> Layout:
        """Named parts and units of a state (S,)."""
        return self.spec.state

    @property
    def control(self) -> Layout:
        """Named parts and units of a control (C,)."""
        return self.spec.control

    @property
    def bounds(self) -> Bounds:
        """Minimum and maximum value of every control."""
        return self.spec.bounds

    @property
    def rest(self) -> Float[np.ndarray, " S"]:
        """State of rest, the default start of motions, as a new array."""
        return np.array(self.spec.rest)

    @property
    def dt(self) -> float:
        """Duration of a super step [s]."""
        return self.spec.dt

    @property
    def substeps(self) -> int:
        """Number of physics steps in a super step."""
        return self.spec.substeps

    @property
    def strides(self) -> int:
        """Number of evaluations of the network in a super step: see `in_strides`."""
        return self.spec.strides

    @property
    def skeleton(self) -> Skeleton:
        """Bones that draw a state."""
        return self.spec.skeleton

    @property
    def rates(self) -> Pairs:
        """(i, j) where state entry j is the time derivative of entry i."""
        return self.spec.rates

    @property
    def gait(self) -> Gait | None:
        """Default gait of the system; None if it has none."""
        return self.spec.gait

    @property
    def definition(self) -> str:
        """JSON text from which the system can be rebuilt; empty for a system that ships."""
        return self.spec.definition

    @property
    def parameter_entries(self) -> tuple[int, ...]:
        """State entries that are parameters, which no motion changes; none in an emulator of a single body."""
        constant = [one for one in self.frame.segments if isinstance(one, Constant)]
        count = sum(segment.size for segment in constant)
        return tuple(range(self.state.size - count, self.state.size))

    @property
    def shown_parameters(self) -> tuple[int, ...]:
        """Indices of the parameters among the plain features."""
        behind = self.encoding.layout.size - self.state.size
        return tuple(self.features.plain.index(entry + behind) for entry in self.parameter_entries)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the family of bodies it was trained on: names, units, ranges of training, nominal values."""
        found = []
        for entry, shown in zip(self.parameter_entries, self.shown_parameters, strict=True):
            name, unit = self.state.names[entry].split("[0] ")
            parameter = Parameter(
                name=name,
                unit=unit,
                low=float(self.domain.low[shown]),
                high=float(self.domain.high[shown]),
                nominal=float(self.spec.rest[entry]),
            )
            found.append(parameter)
        return tuple(found)

    @property
    def origin(self) -> Origin:
        """Axes along which the system may be moved, without any change of its motion."""
        axes = [NOWHERE] * self.encoding.layout.size
        for axis, entries in enumerate(self.frame.free_axes(self.features.plain)):
            for entry in entries:
                axes[entry] = axis
        return Origin(Axes(self.encoding.state_axes(tuple(axes))), Axes(tuple(axes)))

    @property
    def state_structure(self) -> Structure:
        """Structure of states that poses need: their segments, or their mass points."""
        return self.encoding.state_structure(self.frame.segments)

    def step_latent(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> Float[Array, " I"]:
        """Return `step` of a latent state under a latent control, as from `encode` and `encode_control`.

        A deformable body's shape and speed, and the features and the root's speed of any other state, are kept within
        the range of training; a free body sinks no deeper into the ground than in training.
        """
        following = self.step_latent_unbounded(latent, control)
        return self._bounded(latent, following)

    def step_latent_unbounded(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> Float[Array, " I"]:
        """Return the network's prediction from `latent`: `step_latent` without bounds."""
        for _ in range(self.strides):
            latent, _, _ = self.stride_and_units(latent, control)
        return latent

    def stride_and_units(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> tuple[Float[Array, " I"], Units, Float[Array, " K"]]:
        """Return (the latent state one stride later, the network's units, how far features lie beyond their ranges)."""
        raw = self.raw_features(latent, control)
        shown = self.domain.clip(raw)
        odd, even = self.features.streams(latent, self.normaliser.forward(shown))
        units = self.network.units(odd, even)
        change = self.normaliser.inverse(self.network.answers(units, odd, even))
        return self.frame.apply(latent, change, control), units, raw - shown

    def _score(self, units: Units, beyond: Float[Array, " K"]) -> Float[Array, ""]:
        """Return the score of an input with these `units` and with features `beyond` their ranges.

        The network sees clipped features, so the excess is counted here: in standard deviations of the features, or
        in margins of their ranges without a meter.
        """
        if self.meter is None:
            return _root(jnp.sum((beyond / self.domain.margin) ** 2))
        outside = jnp.sum((beyond / self.normaliser.plain_scale) ** 2)
        return _root(self.meter.squared(units) + outside)

    def step_latent_trusted(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> tuple[Float[Array, " I"], Float[Array, ""]]:
        """Return (`step_latent`, the score of its input: see `Emulator.trust`); with strides, their highest score."""
        following, units, beyond = self.stride_and_units(latent, control)
        score = self._score(units, beyond)
        for _ in range(self.strides - 1):
            following, units, beyond = self.stride_and_units(following, control)
            score = jnp.maximum(score, self._score(units, beyond))
        return self._bounded(latent, following), score

    def max_speed(self) -> Float[AnyArray, ""] | float | None:
        """Return the maximum speed of a freely moving body in training [m/s]; None if nothing moves freely."""
        if not self.encoding.keeps_entries:
            return self.encoding.max_speed  # that its encoding keeps to
        local = self._local_features
        return self.frame.max_speed(self.domain.low[local], self.domain.high[local])

    @property
    def _local_features(self) -> slice:
        """Slice of the frame's numbers among the features."""
        first = len(self.features.plain)
        return slice(first, first + self.frame.local_size)

    def _bounded(
        self, before: Float[Array, " I"], following: Float[Array, " I"]
    ) -> Float[Array, " I"]:
        """Return a latent state within bounds, except its parameters: a body outside of the family stays so, and scores so."""
        bounded = self.encoding.bounded(following, self.features, self.domain)
        local = self._local_features
        if self.encoding.keeps_entries:
            low, high = self.domain.widened(KEPT_MARGIN, local)
            bounded = self.frame.kept_in_range(bounded, before, low, high)
        bounded = self.frame.kept_above_ground(bounded, self.domain.low[local])
        if not self.parameter_entries:
            return bounded
        parts = []
        for placed in place_segments(self.frame.segments):
            source = following if isinstance(placed.segment, Constant) else bounded
            parts.append(source[placed.entries])
        return jnp.concatenate(parts)

    def encode(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B I"]:
        """Return the latent states (..., I) in which super steps are computed: few numbers for a deformable body."""
        return self.encoding.encode(state)

    def decode(self, latent: Float[AnyArray, "*B I"]) -> Float[AnyArray, "*B S"]:
        """Return the states (..., S) of `latent` (..., I)."""
        return self.encoding.decode(latent)

    def encode_control(self, control: Float[AnyArray, "*B C"]) -> Float[AnyArray, "*B C"]:
        """Return the latent controls (..., C) for `step_latent`."""
        return self.encoding.encode_control(control)

    def raw_features(
        self, latent: Float[AnyArray, "*B I"], control: Float[AnyArray, "*B C"]
    ) -> Float[AnyArray, "*B K"]:
        """Return the network's features (..., K) other than sines and cosines, not yet normalised.

        Neither the position nor the heading is among them. `latent` and `control` are encoded.
        """
        local = self.frame.local(latent)
        felt = self.frame.felt_control(latent, control)
        return self.features.plain_of(latent, local, felt)

    def raw_features_of(
        self, state: Float[AnyArray, "*B S"], control: Float[AnyArray, "*B C"]
    ) -> Float[AnyArray, "*B K"]:
        """Return `raw_features` (..., K) of the system's state (..., S) and control (..., C)."""
        return self.raw_features(self.encode(state), self.encode_control(control))


def _root(square: Float[Array, ""]) -> Float[Array, ""]:
    """Return the square root, with gradient 0 instead of infinity at 0, so that scores can be penalised."""
    is_positive = square > 0
    return jnp.where(is_positive, jnp.sqrt(jnp.where(is_positive, square, 1.0)), 0.0)


def step(
    emulator: SuperStep, state: Float[Array, " S"], control: Float[Array, " C"]
) -> Float[Array, " S"]:
    """Return the state one super step after `state`. For use inside jit, grad and vmap."""
    origin, latent = begin(emulator, state)
    following = emulator.step_latent(latent, emulator.encode_control(control))
    return emulator.origin.state.moved(emulator.decode(following), origin)


def trust(
    emulator: SuperStep, state: Float[Array, " S"], control: Float[Array, " C"]
) -> Float[Array, ""]:
    """Return the score of `state` under `control`: see `Emulator.trust`. For use inside jit, grad and vmap."""
    return step_trusted(emulator, state, control)[1]


def step_trusted(
    emulator: SuperStep, state: Float[Array, " S"], control: Float[Array, " C"]
) -> tuple[Float[Array, " S"], Float[Array, ""]]:
    """Return (`step`, `trust`) of `state` under `control`. For use inside jit, grad and vmap."""
    origin, latent = begin(emulator, state)
    following, score = emulator.step_latent_trusted(latent, emulator.encode_control(control))
    return emulator.origin.state.moved(emulator.decode(following), origin), score


def begin(
    emulator: SuperStep, state: Float[AnyArray, "*B S"]
) -> tuple[Float[AnyArray, "*B A"], Float[AnyArray, "*B I"]]:
    """Return (the origin of `state`, the latent state relative to it)."""
    axes = emulator.origin.state
    origin = axes.origin(state)
    return origin, emulator.encode(axes.moved(state, -origin))


def locate(emulator: SuperStep, states: Float[np.ndarray, "*B S"]) -> LocatedLatent:
    """Return the latent states of `states` relative to their origins, computed in double precision."""
    origin, latent = begin(emulator, np.asarray(states, float))
    return LocatedLatent(as_float32(latent), origin)


def rollout(
    emulator: SuperStep,
    state: Float[Array, " S"],
    controls: Float[Array, "T C"],
    *,
    unroll: int = UNROLL,
) -> Float[Array, "T+1 S"]:
    """Return the trajectory from `state`, start included. For use inside jit, grad and vmap."""
    return joined(emulator, state, rollout_relative(emulator, state, controls, unroll=unroll))


def joined(
    emulator: SuperStep, state: Float[AnyArray, "*B S"], path: RelativePath
) -> Float[Array, "*B F S"]:
    """Return the trajectory from `state` along `path`."""
    axes = emulator.origin.state
    relative = axes.moved(path.states, path.low)
    way = axes.origin(state)[..., None, :] + path.high
    return jnp.concatenate([state[..., None, :], axes.moved(relative, way)], axis=-2)


class RelativePath(NamedTuple):
    """The T states after a start, each relative to an origin of its own."""

    states: Float[AnyArray, "*B T S"]
    high: Float[AnyArray, "*B T A"]
    """Way of the origin from that of the start."""
    low: Float[AnyArray, "*B T A"]
    """What the rounding of `high` left."""
    scores: Float[AnyArray, "*B T"]
    """Score of each super step, or zero."""


def rollout_relative(
    emulator: SuperStep,
    state: Float[Array, " S"],
    controls: Float[Array, "T C"],
    *,
    is_trusted: bool = False,
    unroll: int = 1,
) -> RelativePath:
    """Return the path from `state`: every super step begins at its own origin. For use inside jit, grad and vmap."""
    axes = emulator.origin.latent

    def super_step(carry: tuple[Array, ...], control: Array) -> tuple[tuple[Array, ...], Any]:
        latent, high, low = carry
        if is_trusted:
            following, score = emulator.step_latent_trusted(latent, control)
        else:
            following, score = emulator.step_latent(latent, control), jnp.zeros((), latent.dtype)
        way = axes.origin(following)
        begun = axes.moved(following, -way), *two_sum(high, low, way)
        return begun, (following, high, low, score)

    _, latent = begin(emulator, state)
    still = jnp.zeros(axes.size, latent.dtype)
    held = emulator.encode_control(controls)
    _, (path, *others) = jax.lax.scan(super_step, (latent, still, still), held, unroll=unroll)
    return RelativePath(emulator.decode(path), *others)


def rollout_latent(
    emulator: SuperStep,
    latent: Float[Array, " I"],
    controls: Float[Array, "T C"],
    *,
    is_bounded: bool = True,
    unroll: int = UNROLL,
) -> Float[Array, "T I"]:
    """Return the latent states after `latent`, one for each of the latent `controls`; the start is not included.

    Training follows the network alone (`is_bounded` false): the effect of bounds on a stray body teaches nothing.
    """
    make_step = emulator.step_latent if is_bounded else emulator.step_latent_unbounded

    def super_step(latent: Array, control: Array) -> tuple[Array, Array]:
        following = make_step(latent, control)
        return following, following

    return jax.lax.scan(super_step, latent, controls, unroll=unroll)[1]


def latent_size(emulator: SuperStep) -> int:
    """Return the length of a latent state."""
    return emulator.encoding.layout.size
