"""One motion's physics again and again, as fast as we have it: for whoever looks for controls without an emulator."""

from __future__ import annotations

import abc
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array
from mujoco import rollout

from neuroanimator.data.sampling import sample_controls
from neuroanimator.systems.cores import core_count
from neuroanimator.systems.deformable.body import Body
from neuroanimator.systems.deformable.deformable_system import MAX_STRAIN, DeformableSystem
from neuroanimator.systems.deformable.mass_spring import strains
from neuroanimator.systems.deformable.native.compiled import LANES, CTwin, c_twin
from neuroanimator.systems.fastest import play
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.rigid.warnings import warnings_counted
from neuroanimator.systems.system import Scheme, System

TRIED_STEPS = 10
"""Super steps that tell which scheme is cheaper."""
TRIES = 5
"""Timings of each, in turn; the least counts."""


class FastPhysics(abc.ABC):
    """Motions of one length from one start. What can be prepared is: only controls differ from call to call."""

    steps: int
    """Physics steps of one motion."""

    @abc.abstractmethod
    def follow(self, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states (G, T, S, L) after each of `controls` (B, T, C), and (B,) whether the physics kept sane.

        Motion b is lane b % L of group b // L. One motion comes alone; more come in room for `batch`.
        """


class MujocoPhysics(FastPhysics):
    """MuJoCo on every core, with the same model, workers and memory for every population."""

    def __init__(
        self,
        system: MujocoSystem,
        scheme: Scheme,
        dt: float,
        start: np.ndarray,
        length: int,
        batch: int,
    ):
        self.system, self.scheme, self.substeps, self.length = (
            system,
            scheme,
            scheme.steps(dt),
            length,
        )
        self.steps, self.batch = self.substeps * length, batch
        self.model, self.start = system.model_with(scheme), np.asarray(start, float)
        self.workers = [mujoco.MjData(self.model) for _ in range(core_count())]
        self._alone = rollout.Rollout(nthread=0)
        first = np.concatenate(
            [[0.0], self.start[: system.physical_size]]
        )  # MuJoCo's state leads with time
        self._initial = np.tile(first, (batch, 1))
        self._states = np.empty((batch, self.steps, len(first)))
        self._sensed = (
            np.empty((batch, self.steps, self.model.nsensordata)) if system.sensors else None
        )

    def follow(self, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states, count = self.roll(controls), len(controls)
        found = np.zeros((1 if count == 1 else self.batch, *states.shape[1:], 1), np.float32)
        with np.errstate(over="ignore"):
            found[:count, ..., 0] = states
        return found, self.system.is_sane(states)

    def roll(self, controls: np.ndarray) -> np.ndarray:
        """Return states (B, T, S) in float64."""
        count = len(controls)
        kind, signal = self.system.drive(np.asarray(controls, float))
        roll = self._alone.rollout if count == 1 else partial(rollout.rollout, persistent_pool=True)
        sensed = self._sensed if self._sensed is None else self._sensed[:count]
        with warnings_counted:
            roll(
                [self.model] * count,
                self.workers[:1] if count == 1 else self.workers,
                self._initial[:count],
                np.repeat(signal, self.substeps, axis=1),
                control_spec=int(kind),
                skip_checks=True,
                nstep=self.steps,
                state=self._states[:count],
                sensordata=sensed,
            )
        ends = slice(self.substeps - 1, None, self.substeps)
        states = self._states[:count, ends, 1:]
        if sensed is None:
            return states
        return np.concatenate([states, sensed[:, ends, list(self.system.sensors)]], axis=-1)


class TwinPhysics(FastPhysics):
    """A mass-spring body's C twin in float32: one body alone, or as many side by side as fill a register."""

    def __init__(
        self, system: DeformableSystem, twins: tuple[CTwin, CTwin], scheme: Scheme, dt: float, start: np.ndarray,
        length: int, batch: int,
    ):  # fmt: skip
        self.body, (self._alone, self._many) = system.body, twins
        self.scheme, self.substeps, self.steps = scheme, scheme.steps(dt), scheme.steps(dt) * length
        self._start = np.asarray(start, np.float32)
        self._starts = np.tile(self._start[:, None], self._many.lanes)
        self._states = np.zeros((batch // LANES, length, len(self._start), LANES), np.float32)

    def follow(self, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states = self._one(controls) if len(controls) == 1 else self._side_by_side(controls)
        return states, np.asarray(_is_whole(self.body, states)).ravel()[: len(controls)]

    def _one(self, controls: np.ndarray) -> np.ndarray:
        return self._play(self._alone, self._start, controls[0])[None, ..., None]

    def _side_by_side(self, controls: np.ndarray) -> np.ndarray:
        def group(number: int) -> None:
            rows = np.arange(number * LANES, (number + 1) * LANES).clip(max=len(controls) - 1)
            self._states[number] = self._play(
                self._many, self._starts, np.moveaxis(controls[rows], 0, -1)
            )

        list(threads().map(group, range(-(-len(controls) // LANES))))
        return self._states

    def _play(self, twin: CTwin, start: np.ndarray, controls: np.ndarray) -> np.ndarray:
        return twin.play(start, controls, self.scheme.integrator, self.scheme.dt, self.substeps)


class SimulatedPhysics(FastPhysics):
    """Whatever else there is: a Python function, or a body where nothing compiles C."""

    def __init__(
        self, system: System, scheme: Scheme, dt: float, start: np.ndarray, length: int, batch: int
    ):
        self.steps, self.batch = scheme.steps(dt) * length, batch
        self._start = np.asarray(start, float)
        self._play: Callable = partial(play, system, dt=dt, scheme=scheme)

    def follow(self, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        runs, count = self._play(np.tile(self._start, (len(controls), 1)), controls), len(controls)
        found = np.zeros(
            (1 if count == 1 else self.batch, *runs.states[0, 1:].shape, 1), np.float32
        )
        found[:count, ..., 0] = runs.states[:, 1:]
        return found, runs.is_alive


def fast_physics(
    system: System, scheme: Scheme, dt: float, start: np.ndarray, length: int, batch: int = 1
) -> FastPhysics:
    """Return the physics of motions of `length` super steps of `dt` [s] from `start` (S,).

    Up to `batch` go at a time, a multiple of `side_by_side`.
    """
    if isinstance(system, MujocoSystem):
        return MujocoPhysics(system, scheme, dt, start, length, batch)
    if isinstance(system, DeformableSystem):
        one, many = c_twin(system.body, np.float32), c_twin(system.body, np.float32, LANES)
        if one and many:
            return TwinPhysics(system, (one, many), scheme, dt, start, length, batch)
    return SimulatedPhysics(system, scheme, dt, start, length, batch)


def side_by_side(system: System) -> int:
    """Return how many motions cost no more time than one of them: the lanes of C, or cores."""
    return LANES if isinstance(system, DeformableSystem) else core_count()


def cheapest_scheme(system: System, dt: float, start: np.ndarray) -> Scheme:
    """Return the system's `scheme`, or for MuJoCo its `truth` where that is cheaper per second: measured now."""
    if not isinstance(system, MujocoSystem):
        return system.scheme
    schemes = (system.scheme, system.truth)
    controls = sample_controls(np.random.default_rng(0), TRIED_STEPS, dt, system.bounds)[None]
    tried = [MujocoPhysics(system, scheme, dt, start, TRIED_STEPS, 1) for scheme in schemes]
    times = np.array([[_seconds(physics, controls) for physics in tried] for _ in range(TRIES)])
    return schemes[int(times.min(axis=0).argmin())]


def _seconds(physics: MujocoPhysics, controls: np.ndarray) -> float:
    began = time.perf_counter()
    physics.roll(controls)
    return time.perf_counter() - began


@cache
def threads() -> ThreadPoolExecutor:
    """Return as many threads as cores, kept."""
    return ThreadPoolExecutor(core_count())


@partial(jax.jit, static_argnums=0)
def _is_whole(body: Body, states: Array) -> Array:
    """Return (G, L) whether a body is finite and not torn apart in all its states (G, T, S, L)."""
    points = states[:, :, : 3 * len(body.masses)]
    positions = points.reshape(*points.shape[:2], -1, 3, points.shape[-1])
    torn = jnp.abs(strains(body, jnp.moveaxis(positions, (2, 3), (0, 1)))) > MAX_STRAIN
    return ~torn.any(axis=(0, 2)) & jnp.isfinite(states).all(axis=(1, 2))
