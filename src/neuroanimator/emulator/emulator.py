"""The emulator: frame → features → normaliser → network → one super step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.backend import backend
from neuroanimator.emulator.arrays import as_float32, as_jax, is_plain
from neuroanimator.emulator.checks import (
    MAX_CONTROL,
    MAX_MAGNITUDE,
    check_motion,
    check_numbers,
)
from neuroanimator.emulator.compiled import Step, as_numpy, call_compiled, is_traced
from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.encoding import Encoding
from neuroanimator.emulator.error_bounds import KINDS, USUAL_LEVEL, ErrorBounds
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.networks.network import Network, Units
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.emulator.trust import EDGE, TrustMeter
from neuroanimator.emulator.verdict import ValidationErrors, Verdict, judge_bounds
from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.state.arrays import AnyArray, as_rows
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout
from neuroanimator.state.structure import Structure
from neuroanimator.zoo import find_emulator, is_name

UNROLL = 4
"""Super steps compiled into one loop body: 10 % faster than one; eight gain nothing more."""


MAX_STRIDES = 16
"""Most strides of a super step: each is compiled one by one."""


class Emulator(eqx.Module):
    """A network that leaps a system one super step ahead: s + change(s, u) (SIGGRAPH 98, eq. 7)."""

    frame: Frame
    features: Features
    normaliser: Normaliser
    network: Network
    domain: Domain
    spec: EmulatorSpec
    encoding: Encoding
    """What the latent state is in which super steps are made."""
    meter: TrustMeter | None = None
    """Tells how far an input lies from what training showed; None in files from before there was one."""
    calibration: ErrorBounds | None = None
    """How far rollouts go astray; None where nobody measured it: see `error_bounds`."""
    validation: ValidationErrors | None = None
    """How far one super step goes astray where it was trained; None in files from before training told it."""

    # By identity, so that `jax.jit(emulator.rollout)` finds what it compiled again.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

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
        """Lowest and highest value of every control."""
        return self.spec.bounds

    @property
    def rest(self) -> Float[np.ndarray, " S"]:
        """A state of rest, as a new array: motions begin there if nothing else is said."""
        return np.array(self.spec.rest)

    @property
    def dt(self) -> float:
        """Time one super step covers [s]."""
        return self.spec.dt

    @property
    def substeps(self) -> int:
        """Physics steps one super step stands for."""
        return self.spec.substeps

    @property
    def strides(self) -> int:
        """Number of times the network is asked in a super step: see `in_strides`."""
        return self.spec.strides

    @property
    def skeleton(self) -> Skeleton:
        """Bones to draw a state with."""
        return self.spec.skeleton

    @property
    def rates(self) -> tuple[tuple[int, int], ...]:
        """(i, j) where state entry j is the time derivative of entry i."""
        return self.spec.rates

    @property
    def gait(self) -> Gait | None:
        """How the system moves along if nothing else is said; None where it has no such way."""
        return self.spec.gait

    @property
    def definition(self) -> str:
        """JSON text the system can be made from again; empty for one that comes with the package."""
        return self.spec.definition

    @property
    def state_structure(self) -> Structure:
        """What a pose needs to know of states: their segments, or the mass points they are of."""
        return self.encoding.state_structure(self.frame.segments)

    @property
    def verdict(self) -> Verdict | None:
        """Whether it is of any use where it was trained, and why, from what its file tells; None where that tells nothing.

        `trust` says how near that is.
        """
        if self.validation is not None:
            return self.validation.verdict
        if self.calibration is not None:
            return judge_bounds(self.calibration)
        return None

    @property
    def step(self) -> Step:
        """`step(state (S,), control (C,))` is the state (S,) `dt` seconds later: see `Step.__call__`.

        A function that can be called from Python, and given to `jax.jit`,
        `jax.grad` and `jax.vmap`.
        """
        return Step(step, program_of, self)

    def step_latent(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> Float[Array, " I"]:
        """Return `step` of a latent state under a latent control: those of `encode` and `encode_control`.

        A deformable body's shape and speed, and the numbers a network is shown of any other state, are kept within
        what training showed.
        """
        following = self.step_latent_unbounded(latent, control)
        return self.encoding.bounded(following, self.features, self.domain)

    def step_latent_unbounded(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> Float[Array, " I"]:
        """Return what the network makes of `latent`: `step_latent` before anything is kept within bounds."""
        for _ in range(self.strides):
            latent, _, _ = self.stride_and_units(latent, control)
        return latent

    def _trusted_stride(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> tuple[Float[Array, " I"], Float[Array, ""]]:
        """Return (the latent state one stride later, the score of `latent` and `control`)."""
        following, units, beyond = self.stride_and_units(latent, control)
        return following, self._score(units, beyond)

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
        """Return the score of what the network makes of an input, whose features lie `beyond` their ranges.

        The network is not shown that, so that it is counted here: in standard deviations of the features, or
        in margins of their ranges where there is no meter.
        """
        if self.meter is None:
            return _root(jnp.sum((beyond / self.domain.margin) ** 2))
        outside = jnp.sum((beyond / self.normaliser.plain_scale) ** 2)
        return _root(self.meter.squared(units) + outside)

    def step_latent_trusted(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> tuple[Float[Array, " I"], Float[Array, ""]]:
        """Return (`step_latent`, the score of its input: see `trust`); of several strides the highest."""
        following, score = self._trusted_stride(latent, control)
        for _ in range(self.strides - 1):
            following, further = self._trusted_stride(following, control)
            score = jnp.maximum(score, further)
        return self.encoding.bounded(following, self.features, self.domain), score

    def trust_latent(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> Float[Array, ""]:
        """Return `trust` of a latent state under a latent control; inside jit, grad and vmap too."""
        return self.step_latent_trusted(latent, control)[1]

    def in_strides(self, count: int) -> Emulator:
        """Return the emulator whose super step is `count` of this one's in a row, under one control: its strides.

        It costs `count` times as much, and is nearer to the physics than one leap as long wherever a shorter one is easier to
        learn: see `docs/decisions/0017-strides.md`.

        Raises ArgumentError if that are more strides than a file may have.
        """
        strides = self.strides * count
        if not 1 <= strides <= MAX_STRIDES:
            raise ArgumentError(f"count: wanted 1 to {MAX_STRIDES} strides in all, came {strides}.")
        spec = replace(
            self.spec, substeps=self.substeps * count, dt=self.dt * count, strides=strides
        )
        # Neighbouring strides change the state alike, so that their changes add up.
        normaliser = replace(self.normaliser, unit=self.normaliser.unit * count)
        # What was measured of single strides says nothing of super steps.
        return replace(self, spec=spec, normaliser=normaliser, calibration=None, validation=None)

    def rest_streams(self) -> tuple[Float[Array, " O"], Float[Array, " E"]]:
        """Return what the network sees at rest without control; left and right are alike there, to the last bit."""
        latent = np.asarray(self.encode(self.rest))
        control = np.asarray(self.encode_control(self.bounds.idle))
        raw = np.asarray(self.raw_features(latent, control))
        return _streams_at_rest(self, as_float32(latent), as_float32(raw))

    def at_rest(self, streams: tuple[Float[Array, " O"], Float[Array, " E"]]) -> Emulator:
        """Return the emulator that stays at rest: what the network says of it, `rest_streams`, is taken away.

        Only for systems that keep still there. It costs nothing: the mean change takes it up.
        """
        change_at_rest = self.normaliser.change_scale * self.network(*streams)
        normaliser = replace(self.normaliser, change_mean=0.0 - change_at_rest)
        return replace(self, normaliser=normaliser)

    def encode(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B I"]:
        """Return the latent states (..., I) in which super steps are made: of a deformable body few numbers."""
        return self.encoding.encode(state)

    def decode(self, latent: Float[AnyArray, "*B I"]) -> Float[AnyArray, "*B S"]:
        """Return the states (..., S) of `latent` (..., I)."""
        return self.encoding.decode(latent)

    def encode_control(self, control: Float[AnyArray, "*B C"]) -> Float[AnyArray, "*B C"]:
        """Return the latent controls (..., C), as `step_latent` takes them."""
        return self.encoding.encode_control(control)

    def encode_motion(
        self, state: ArrayLike, controls: ArrayLike
    ) -> tuple[Float[Array, "*B I"], Float[Array, "*T C"]]:
        """Return a start (S,) and the controls (..., C) from there on as `step_latent` takes them, in float32."""
        return self.encode(as_jax(state)), self.encode_control(as_jax(controls))

    def raw_features(
        self, latent: Float[AnyArray, "*B I"], control: Float[AnyArray, "*B C"]
    ) -> Float[AnyArray, "*B K"]:
        """Return (..., K) what the network sees besides sines and cosines, not yet normalised.

        Neither the position nor the heading is among it. `latent` and `control` are encoded.
        """
        local = self.frame.local(latent)
        felt = self.frame.felt_control(latent, control)
        return self.features.plain_of(latent, local, felt)

    def raw_features_of(
        self, state: Float[AnyArray, "*B S"], control: Float[AnyArray, "*B C"]
    ) -> Float[AnyArray, "*B K"]:
        """Return `raw_features` (..., K) of a state (..., S) and a control (..., C) as the system has them."""
        return self.raw_features(self.encode(state), self.encode_control(control))

    def rollout(
        self, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool = False
    ) -> Float[AnyArray, "*B F S"]:
        """Return the trajectory (T+1, S) from `state` (S,) under `controls` (T, C), the start included.

        A batch is `state` (B, S) with `controls` (B, T, C). With `may_diverge`, numbers that are not finite are
        returned where the motion comes to that. Of arrays of JAX it is one of JAX; of all else it is one of
        NumPy, computed by the `backend`. Inside `jax.jit`, `jax.grad` and `jax.vmap` nothing but shapes is checked.

        Raises ArgumentError for wrong shapes, for numbers that are not finite or larger than `MAX_MAGNITUDE`, and
        for states no motion follows from; DivergedError where a motion ends in numbers that are not finite.
        """
        if is_plain(state) and is_plain(controls):
            sound = _sound_rollout(self, state, controls)
            if sound is not None:
                return sound
        if is_traced((state, controls)):
            _check_shapes(self, np.shape(state), np.shape(controls))
            return _rollout(self, as_jax(state), as_jax(controls))
        start, held = _checked(self, state, controls)
        if not held.shape[-2]:
            return start[..., None, :]
        trajectory = _rollout(self, start, held)
        if not may_diverge:
            check_motion(np.asarray(trajectory), self.state)
        return trajectory

    def rollout_trusted(
        self, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool = False
    ) -> tuple[Float[np.ndarray, "*B F S"], Float[np.ndarray, "*B T"]]:
        """Return (`rollout`, the score (T,) of each super step: see `trust`), for little more than the cost of the rollout.

        Scores are infinite where numbers are not finite. Always arrays of NumPy; not for use inside jit, grad and vmap.

        Raises what `rollout` does.
        """
        start, held = (np.ascontiguousarray(part) for part in _checked(self, state, controls))
        trajectory, scores = _rollout_trusted(self, start, held)
        if not may_diverge:
            check_motion(trajectory, self.state)
        return trajectory, np.where(np.isfinite(scores), scores, np.inf)

    def trust(self, state: ArrayLike, control: ArrayLike) -> Float[np.ndarray, " *B"]:
        """Return how far `state` (..., S) with `control` (..., C) lies from what this emulator was trained on.

        1 is the edge: 99 of a hundred super steps of training lie within it. The more above it, the less is known. It is
        the disagreement that last layers as likely as the one it has would come to (`TrustMeter`), and how far
        features leave their ranges. Infinite for what is not finite. Files from before there was a
        meter know the ranges alone: inside them the score is 0.

        It asks about states as they are, such as the physics' or recorded ones. For a motion that this emulator made ask
        `rollout_trusted`: super steps go on from latent states, and encoding what was decoded gives a deformable
        body's shape back only nearly.

        Raises ArgumentError for wrong shapes.
        """
        states = self.state.check_shape(state, "state")
        controls = self.control.check_shape(control, "control")
        if states.shape[:-1] != controls.shape[:-1]:
            raise ArgumentError(
                f"state and control: wanted as many of one as of the other, came {states.shape} with {controls.shape}."
            )
        scores = _scores(self, as_float32(states), as_float32(controls))
        is_number = (np.abs(states) <= MAX_MAGNITUDE).all(axis=-1)
        is_number &= np.isfinite(controls).all(axis=-1) & np.isfinite(scores)
        return np.where(is_number, scores, np.inf)

    def error_bounds(
        self,
        state: ArrayLike,
        controls: ArrayLike,
        *,
        level: float = USUAL_LEVEL,
        are_optimised: bool = False,
    ) -> Float[np.ndarray, "*B T"]:
        """Return what the error of `rollout` stays below after each super step (T,), in a share `level` of motions.

        The error is the root mean square over all numbers of the state that move, in standard deviations of their usual
        change in a super step (`calibration.unit`). The bound grows with the scores on the way (`trust`). It was measured
        on runs that training left out, under controls as in training; say `are_optimised` of controls that were found by
        descending through this emulator, which lead where it errs more. Infinite after more super steps than were measured.

        Raises ArgumentError for a level there is no bound of, for an emulator whose errors nobody measured (see
        `fit_error_bounds`), and for what `rollout` refuses.
        """
        calibration = self.calibration
        if calibration is None:
            raise ArgumentError(
                f"{self.system}: this emulator brings no error bounds. na.fit_error_bounds(emulator) measures them."
            )
        if level not in calibration.levels:
            levels = ", ".join(f"{known:g}" for known in calibration.levels)
            raise ArgumentError(f"level: wanted one of {levels}, came {level}.")
        if are_optimised and not calibration.knows_optimised:
            raise ArgumentError(
                f"are_optimised: {self.system} was measured under random controls alone, for it cannot be simulated."
            )
        _, scores = self.rollout_trusted(state, controls, may_diverge=True)
        return calibration.along(np.asarray(scores, float), level, KINDS[are_optimised])

    def covers(self, state: ArrayLike, control: ArrayLike) -> bool:
        """Return whether `state` (S,) with `control` (C,) is what this emulator was trained on: `trust` says at most 1.

        Controls are covered between their bounds. What is not finite is covered nowhere.

        Raises ArgumentError for wrong shapes.
        """
        is_known = bool(np.all(self.trust(state, control) <= EDGE))
        return is_known and self.bounds.contain(np.asarray(control, float))

    def save(self, path: str | Path) -> None:
        """Write the emulator as one `.safetensors` file."""
        from neuroanimator.emulator.artifact import save

        save(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Emulator:
        """Return the emulator in the file at `path`, or the one that ships under the name `path`: "fish-50".

        A name has no folder and no suffix. BadFileError says what is wrong with a file, and lists the names.
        """
        from neuroanimator.emulator.artifact import load

        file = find_emulator(path) if isinstance(path, str) and is_name(path) else Path(path)
        return load(file)

    def __repr__(self) -> str:
        spec = self.spec
        network = type(self.network).__name__.lower()
        widths = "x".join(map(str, self.network.widths))
        strides = f" in {spec.strides} strides" if spec.strides > 1 else ""
        verdict = f", {self.verdict.word}" if self.verdict else ""
        return (
            f'Emulator("{spec.system}", {spec.substeps} substeps, dt {spec.dt:g} s, '
            f"{spec.state.size} states, {spec.control.size} controls, {network} {widths}{strides}{verdict})"
        )


def _sound_rollout(
    emulator: Emulator, state: Float[np.ndarray, " ..."], controls: Float[np.ndarray, " ..."]
) -> Float[np.ndarray, "*B F S"] | None:
    """Return `rollout` in C, where all shapes and numbers are found in order there.

    None where they are not, or where there is no C: then the long way has to be gone, which says what is wrong.
    """
    program = program_of(emulator)
    if program is None:
        return None
    if program.takes_rollout(state, controls):
        trajectory, is_sound = program.rollout(as_float32(state), as_float32(controls))
        return trajectory if is_sound else None
    if program.takes_rollouts(state, controls):
        trajectories, are_sound = program.rollouts(as_float32(state), as_float32(controls))
        return trajectories if are_sound else None
    return None


def _rollout(
    emulator: Emulator, state: Float[AnyArray, "*B S"], controls: Float[AnyArray, "*B T C"]
) -> Float[AnyArray, "*B F S"]:
    """Return `rollout` of what has been checked, in arrays of the same library."""
    function = _quick_rollouts if state.ndim == 2 else _quick_rollout
    if isinstance(state, jax.Array):
        return call_compiled(function, emulator, state, controls)
    program = program_of(emulator)
    if program is None:
        return as_numpy(call_compiled(function, emulator, state, controls))
    run = program.rollouts if state.ndim == 2 else program.rollout
    trajectory, _ = run(state, controls)
    return trajectory


def _rollout_trusted(
    emulator: Emulator, state: Float[np.ndarray, "*B S"], controls: Float[np.ndarray, "*B T C"]
) -> tuple[Float[np.ndarray, "*B F S"], Float[np.ndarray, "*B T"]]:
    """Return `rollout_trusted` of what has been checked, by the `backend`."""
    starts = state.reshape(-1, state.shape[-1])
    held = controls.reshape(len(starts), *controls.shape[-2:])
    program = program_of(emulator)
    if program is None:
        parts = call_compiled(_quick_rollouts_trusted, emulator, starts, held)
        motions, scores = (as_numpy(part) for part in parts)
    else:
        motions, scores = program.rollouts_trusted(starts, held)
    shape = state.shape[:-1]
    return motions.reshape(*shape, *motions.shape[1:]), scores.reshape(*shape, held.shape[1])


def _scores(
    emulator: Emulator, states: Float[np.ndarray, "*B S"], controls: Float[np.ndarray, "*B C"]
) -> Float[np.ndarray, " *B"]:
    """Return the scores of states under controls, by the `backend`; where rows are not finite, anything."""
    rows = as_rows(states)
    held = as_rows(controls)
    program = program_of(emulator)
    if program is None:
        scores = as_numpy(call_compiled(_trust_of_rows, emulator, rows, held))
    else:
        pairs = zip(rows, held, strict=True)
        scores = np.array([program.trust(row, control) for row, control in pairs], np.float32)
    return np.asarray(scores).reshape(states.shape[:-1])


def _root(square: Float[Array, ""]) -> Float[Array, ""]:
    """Return the square root; its gradient at 0 is 0, not without bounds, so that scores may be penalised."""
    is_positive = square > 0
    return jnp.where(is_positive, jnp.sqrt(jnp.where(is_positive, square, 1.0)), 0.0)


def _trust_of_rows(
    emulator: Emulator, states: Float[Array, "N S"], controls: Float[Array, "N C"]
) -> Float[Array, " N"]:
    """Return the score of each state under its control."""
    return jax.vmap(lambda state, control: trust(emulator, state, control))(states, controls)


def _checked(
    emulator: Emulator, state: ArrayLike, controls: ArrayLike
) -> tuple[Float[AnyArray, "*B S"], Float[AnyArray, "*B T C"]]:
    """Return both in the emulator's own numbers: as arrays of JAX where one of them is, else of NumPy."""
    dtype = emulator.normaliser.change_scale.dtype
    start = check_numbers(state, emulator.state, "state", MAX_MAGNITUDE, dtype)
    held = check_numbers(controls, emulator.control, "controls", MAX_CONTROL, dtype)
    _check_shapes(emulator, start.shape, held.shape)
    if isinstance(state, jax.Array) or isinstance(controls, jax.Array):
        return as_jax(start, dtype), as_jax(held, dtype)
    return start, held


def _check_shapes(emulator: Emulator, state: tuple[int, ...], controls: tuple[int, ...]) -> None:
    """Refuse shapes that are not (S,) with (T, C), or (B, S) with (B, T, C)."""
    sizes = (*state[-1:], *controls[-1:])
    if (
        len(state) not in (1, 2)
        or len(controls) != len(state) + 1
        or state[:-1] != controls[:-2]
        or sizes != (emulator.state.size, emulator.control.size)
    ):
        raise ArgumentError(
            f"state and controls: wanted (S,) with (T, C) or (B, S) with (B, T, C), "
            f"came {state} with {controls}."
        )


def step(
    emulator: Emulator, state: Float[Array, " S"], control: Float[Array, " C"]
) -> Float[Array, " S"]:
    """Return the state one super step after `state`. For use inside jit, grad and vmap."""
    latent = emulator.encode(state)
    following = emulator.step_latent(latent, emulator.encode_control(control))
    return emulator.decode(following)


def trust(
    emulator: Emulator, state: Float[Array, " S"], control: Float[Array, " C"]
) -> Float[Array, ""]:
    """Return the score of `state` under `control`: see `Emulator.trust`. For use inside jit, grad and vmap."""
    return emulator.trust_latent(emulator.encode(state), emulator.encode_control(control))


def rollout(
    emulator: Emulator,
    state: Float[Array, " S"],
    controls: Float[Array, "T C"],
    *,
    unroll: int = UNROLL,
) -> Float[Array, "T+1 S"]:
    """Return the trajectory from `state`, start included. For use inside jit, grad and vmap."""
    start = emulator.encode(state)
    latent = rollout_latent(emulator, start, emulator.encode_control(controls), unroll=unroll)
    return jnp.concatenate([state[None], emulator.decode(latent)])


def rollout_latent(
    emulator: Emulator,
    latent: Float[Array, " I"],
    controls: Float[Array, "T C"],
    *,
    is_bounded: bool = True,
    unroll: int = UNROLL,
) -> Float[Array, "T I"]:
    """Return the latent states after `latent`, one for each of the latent `controls`; the start is not included.

    Training follows the network alone (`is_bounded` false): what bounds do to a stray body teaches nothing.
    """
    make_step = emulator.step_latent if is_bounded else emulator.step_latent_unbounded

    def super_step(latent: Array, control: Array) -> tuple[Array, Array]:
        following = make_step(latent, control)
        return following, following

    return jax.lax.scan(super_step, latent, controls, unroll=unroll)[1]


def _quick_rollout(
    emulator: Emulator, state: Float[Array, " S"], controls: Float[Array, "T C"]
) -> Float[Array, "T+1 S"]:
    """Return `rollout`, not unrolled: a tenth slower, but compiled in a third of the time."""
    return rollout(emulator, state, controls, unroll=1)


def _quick_rollouts(
    emulator: Emulator, states: Float[Array, "B S"], controls: Float[Array, "B T C"]
) -> Float[Array, "B T+1 S"]:
    """Return `_quick_rollout` from each of `states` (B, S) under `controls` (B, T, C)."""
    return jax.vmap(lambda state, held: _quick_rollout(emulator, state, held))(states, controls)


def _quick_rollouts_trusted(
    emulator: Emulator, states: Float[Array, "B S"], controls: Float[Array, "B T C"]
) -> tuple[Float[Array, "B T+1 S"], Float[Array, "B T"]]:
    """Return `_quick_rollouts`, and the score of each super step."""

    def super_step(latent: Array, control: Array) -> tuple[Array, tuple[Array, Array]]:
        following, score = emulator.step_latent_trusted(latent, control)
        return following, (following, score)

    def one(state: Float[Array, " S"], held: Float[Array, "T C"]) -> tuple[Array, Array]:
        start = emulator.encode(state)
        _, (latent, scores) = jax.lax.scan(super_step, start, emulator.encode_control(held))
        return jnp.concatenate([state[None], emulator.decode(latent)]), scores

    return jax.vmap(one)(states, controls)


@eqx.filter_jit
def _streams_at_rest(
    emulator: Emulator, latent: Float[AnyArray, " I"], raw: Float[AnyArray, " K"]
) -> tuple[Float[Array, " O"], Float[Array, " E"]]:
    """Return what the network sees of `latent` and its `raw` features, where left and right are alike."""
    plain = emulator.normaliser.forward(emulator.domain.clip(raw))
    odd, even = emulator.features.streams(latent, plain)
    if emulator.features.is_odd:
        odd = jnp.zeros_like(odd)
    return odd, even


def latent_size(emulator: Emulator) -> int:
    """Return the length of a latent state."""
    return emulator.encoding.layout.size


def program_of(emulator: Emulator) -> Any:
    """Return the `CEmulator` that runs `emulator` in C, if the `backend` is C and there is such a program.

    Raises ResourceError where nothing but C will do, and there is none.
    """
    asked = backend()
    if asked == "jax":
        return None
    # It is written in terms of this module.
    from neuroanimator.emulator.c_emulator import c_emulator

    program = c_emulator(emulator)
    if program is None and asked == "c":
        raise ResourceError(
            "backend: wanted C, but this emulator has no program in C here. Install a C compiler (pip install "
            "'neuroanimator[compiler]' brings one), or use the backend auto."
        )
    return program


def as_emulator(reference: Emulator | str | Path) -> Emulator:
    """Return an emulator as it is; of a file's or a system's name, the emulator that verbs take for it."""
    if isinstance(reference, Emulator):
        return reference
    return Emulator.load(find_emulator(str(reference)))


def load_emulator(name: str | Path) -> Emulator:
    """Return the emulator that ships under `name`, such as "fish-50", or the one in the file of that name.

    BadFileError says what is wrong with a file, and lists the names.
    """
    return Emulator.load(name)
