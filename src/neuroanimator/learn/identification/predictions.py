"""Predicted sensor readings of motions with given starts and unknowns, by an emulator or by the physics, and their slopes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import UNROLL, latent_size, rollout_latent
from neuroanimator.learn.identification.measurements import Measurements
from neuroanimator.learn.identification.unknowns import Unknowns
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.system import Scheme, System

DIFFERENCE = 1e-4
"""Step of finite differences in an unknown, as a share of its range."""

START_DIFFERENCE = 1e-5
"""Step of finite differences in the numbers of a start [rad, m, rad/s or m/s]."""


class Slopes(NamedTuple):
    """Predictions and their derivatives."""

    shown: Float[np.ndarray, "W F S"]
    """Numbers of the state as read by sensors."""
    by_unknowns: Float[np.ndarray, "W F S G"]
    by_starts: Float[np.ndarray, "W F S V"]
    """Derivatives by changes of the start in the body's frame."""


class Prediction(NamedTuple):
    """Predicted sensor readings."""

    shown: Float[np.ndarray, "W F S"]
    slopes: Slopes | None = None
    """Their derivatives, where they cost little more."""


class Predictor:
    """Predictions of windows of measurements, from starts as latent states; from measured states if `knows_starts`."""

    def __init__(
        self,
        emulator: Emulator,
        measurements: Measurements,
        unknowns: Unknowns,
        *,
        knows_starts: bool = False,
    ):
        self.emulator = emulator
        self.unknowns = unknowns
        self.controls = _single(emulator.encode_control(measurements.controls))
        self._held = measurements.controls
        self._places = _Places(
            moving=latent_size(emulator) - len(emulator.parameter_entries),
            parameters=len(emulator.parameter_entries),
            has_delay=unknowns.has_delay,
            offsets=unknowns.offsets,
        )
        # Starts change directly, without coasting.
        self._still = replace(emulator.frame, dt=0.0)
        self.start_size = 0 if knows_starts else self._still.change_size(latent_size(emulator))
        """Number of unknowns of a start."""

    def starts_at(self, states: Float[np.ndarray, "W S"]) -> Float[np.ndarray, "W I"]:
        """Return the starts of motions that begin at `states`."""
        if not self.start_size:
            return states
        return np.array(self.emulator.encode(np.asarray(states, float)))

    def moved(
        self, starts: Float[np.ndarray, "W I"], change: Float[np.ndarray, "W V"]
    ) -> Float[np.ndarray, "W I"]:
        """Return the starts after a change in the body's frame; those that are known stay."""
        if not self.start_size:
            return starts
        return np.asarray(self._still.apply(starts, change), float)

    def slopes(self, starts: Float[np.ndarray, "W I"], values: Float[np.ndarray, " G"]) -> Slopes:
        """Return the sensor readings of the emulator's motions from `starts`, with their derivatives."""
        arrays = _slopes(
            self.emulator,
            self._still,
            self._places,
            self.start_size,
            _single(starts),
            _single(values),
            self.controls,
        )
        return Slopes(*(np.asarray(array, float) for array in arrays))

    def by_emulator(
        self, starts: Float[np.ndarray, "W I"], values: Float[np.ndarray, " G"]
    ) -> Prediction:
        """Return the emulator's motions with their derivatives: nearly all of them are needed for the next step."""
        slopes = self.slopes(starts, values)
        return Prediction(slopes.shown, slopes)

    def by_physics(
        self,
        system: System,
        starts: Float[np.ndarray, "W I"],
        values: Float[np.ndarray, " G"],
    ) -> Prediction:
        """Return the sensor readings of the true motions from `starts`; NaN where the physics diverges."""
        return Prediction(self._by_physics(system, starts[None], values[None], system.truth)[0])

    def _by_physics(
        self,
        system: System,
        starts: Float[np.ndarray, "N W I"],
        values: Float[np.ndarray, "N G"],
        scheme: Scheme,
    ) -> Float[np.ndarray, "N W F S"]:
        """Return `by_physics` for several starts and values with steps of `scheme`, all simulated at once."""
        count, windows, _ = starts.shape
        latents = starts.copy()
        latents[..., self._places.moving :] = values[:, None, : self._places.parameters]
        bodies = np.asarray(self.emulator.decode(latents), float)
        possible, _ = system.closed(bodies.reshape(count * windows, -1))
        held = np.tile(system.bounds.clip(self._held), (count, 1, 1))
        runs = system.simulate_fastest(possible, held, self.emulator.dt, scheme)
        states = np.where(runs.has_diverged[:, None, None], np.nan, runs.states)
        motions = states.reshape(count, windows, *states.shape[1:])
        shown = [
            _observed(self._places, self.emulator.dt, motion, unknowns)
            for motion, unknowns in zip(motions, values, strict=True)
        ]
        return np.stack(shown)

    def slopes_by_physics(
        self,
        system: System,
        starts: Float[np.ndarray, "W I"],
        values: Float[np.ndarray, " G"],
    ) -> Slopes:
        """Return the physics' motions with their derivatives, by differences; the emulator's where the physics diverges.

        Uses the system's own step, which is cheaper than that of `by_physics`: slopes need not be as exact.
        """
        emulated = self.slopes(starts, values)
        count = 1 + len(values) + self.start_size
        all_starts = np.repeat(starts[None], count, axis=0)
        all_values = np.repeat(values[None], count, axis=0)
        unknowns = self.unknowns
        steps = DIFFERENCE * (unknowns.high - unknowns.low)
        inward = np.where(values > (unknowns.low + unknowns.high) / 2, -steps, steps)
        for place, step in enumerate(inward):
            all_values[1 + place, place] += step
        for place in range(self.start_size):
            change = np.zeros((len(starts), self.start_size))
            change[:, place] = START_DIFFERENCE
            all_starts[1 + len(values) + place] = self.moved(starts, change)
        shown, *others = self._by_physics(system, all_starts, all_values, system.scheme)
        steps_taken = np.append(inward, np.full(self.start_size, START_DIFFERENCE))
        slopes = [(other - shown) / step for other, step in zip(others, steps_taken, strict=True)]
        found = np.stack(slopes, axis=-1)
        otherwise = np.concatenate([emulated.by_unknowns, emulated.by_starts], axis=-1)
        known = np.where(np.isfinite(found), found, otherwise)
        by_unknowns = known[..., : len(values)].copy()
        return Slopes(shown, by_unknowns, known[..., len(values) :].copy())


class _Places(eqx.Module):
    """Indices of each kind of unknown."""

    moving: int = eqx.field(static=True)
    """Number of entries of a latent state before its parameters."""
    parameters: int = eqx.field(static=True)
    has_delay: bool = eqx.field(static=True)
    offsets: tuple[int, ...] = eqx.field(static=True)


def _single(values: Float[np.ndarray, " ..."]) -> Float[Array, " ..."]:
    return jnp.asarray(values, jnp.float32)


@eqx.filter_custom_jvp
def _rollout(
    emulator: Emulator, latent: Float[Array, " I"], controls: Float[Array, "T C"]
) -> Float[Array, "T I"]:
    """Return the latent states after `latent`, whose derivatives by it are products of the super steps' Jacobians.

    A Jacobian has as many rows as there are numbers that move, fewer than there are unknowns with parameters, and those of
    all super steps are found side by side.
    """
    return rollout_latent(emulator, latent, controls, is_bounded=False)


@_rollout.def_jvp
def _rollout_slope(primals: Any, tangents: Any) -> tuple[Array, Array]:
    emulator, latent, controls = primals
    _, change, _ = tangents
    moving = len(latent) - len(emulator.parameter_entries)
    following = rollout_latent(emulator, latent, controls, is_bounded=False)
    before = jnp.concatenate([latent[None], following[:-1]])

    def moved(latent: Array, control: Array) -> Array:
        return emulator.step_latent_unbounded(latent, control)[:moving]

    def pushed(change: Array, jacobian: Array) -> tuple[Array, Array]:
        later = jnp.concatenate([jacobian @ change, change[moving:]])
        return later, later

    jacobians = jax.vmap(jax.jacrev(moved))(before, controls)
    _, changes = jax.lax.scan(pushed, change, jacobians, unroll=UNROLL)
    return following, changes


def _observed(
    places: _Places, dt: float, states: Float[AnyArray, "... F S"], values: Float[AnyArray, " G"]
) -> Float[AnyArray, "... F S"]:
    """Return the readings of a motion by sensors with a delay and offsets.

    States between super steps are interpolated by a parabola through three of them, and extrapolated by it
    before the first.
    """
    if places.has_delay:
        states = _delayed(states, values[places.parameters] / dt)
    if places.offsets:
        one_of_each = np.eye(states.shape[-1], dtype=states.dtype)[list(places.offsets)]
        states = states + values[-len(places.offsets) :] @ one_of_each
    return states


def _delayed(
    states: Float[AnyArray, "... F S"], steps: Float[AnyArray, ""]
) -> Float[AnyArray, "... F S"]:
    """Return the states `steps` super steps earlier."""
    xp = states.__array_namespace__()
    frames = states.shape[-2]
    times = xp.arange(frames) - steps
    middle = xp.clip(xp.round(times), 1, frames - 2).astype(int)
    away = (times - middle)[:, None]
    before = states[..., middle - 1, :]
    here = states[..., middle, :]
    after = states[..., middle + 1, :]
    slope = (after - before) / 2
    bend = after - 2 * here + before
    return here + away * slope + away**2 * bend / 2


@eqx.filter_jit
def _slopes(
    emulator: Emulator,
    still: Frame,
    places: _Places,
    start_size: int,
    starts: Float[Array, "W I"],
    values: Float[Array, " G"],
    controls: Float[Array, "W T C"],
) -> tuple[Float[Array, "W F S"], Float[Array, "W F S G"], Float[Array, "W F S V"]]:
    def shown(values: Array, change: Array, start: Array, held: Array) -> tuple[Array, Array]:
        parameters = values[: places.parameters]
        if start_size:
            moving = still.apply(start, change)[: places.moving]
            latent = jnp.concatenate([moving, parameters])
        else:  # a measured state, whose shape is encoded with the parameters
            moving = start[: len(start) - places.parameters]
            latent = emulator.encode(jnp.concatenate([moving, parameters]))
        following = _rollout(emulator, latent, held)
        states = emulator.decode(jnp.concatenate([latent[None], following]))
        seen = _observed(places, emulator.dt, states, values)
        return seen, seen

    def slopes(start: Array, held: Array) -> tuple[Array, Array, Array]:
        derivatives = jax.jacfwd(shown, argnums=(0, 1), has_aux=True)
        (by_values, by_start), seen = derivatives(values, jnp.zeros(start_size), start, held)
        return seen, by_values, by_start

    return jax.vmap(slopes)(starts, controls)
