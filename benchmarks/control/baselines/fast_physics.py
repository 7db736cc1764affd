"""One motion's physics again and again, as fast as we have it: for whoever looks for controls without an emulator."""

from __future__ import annotations

import abc
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float
from mujoco import rollout as mujoco_rollout

from neuroanimator.codegen.cores import core_count
from neuroanimator.physics.deformable.body import Body
from neuroanimator.physics.deformable.deformable_system import MAX_STRAIN, DeformableSystem
from neuroanimator.physics.deformable.mass_spring import strains
from neuroanimator.physics.deformable.native.compiled import SINGLE_LANES, CTwin, c_twin
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.systems.random_controls import sample_controls
from neuroanimator.systems.system import Scheme, System

TRIED_STEPS = 10
"""Number of super steps that tell which scheme is cheaper."""

TRIES = 5
"""Number of timings of each scheme, in turn; the least time counts."""


class FastPhysics(abc.ABC):
    """Motions of one length from one start. What can be prepared is: only controls differ from call to call."""

    steps: int
    """Physics steps of one motion."""

    @abc.abstractmethod
    def rollout(
        self, controls: Float[np.ndarray, "B T C"]
    ) -> tuple[Float[np.ndarray, "G T S L"], Bool[np.ndarray, " B"]]:
        """Return the states after each control, and whether the physics diverged in each motion.

        Motion b is lane b % L of group b // L. One motion comes alone; more come in room for `batch`. The states may be
        a buffer that the next call overwrites: copy what must last longer.
        """


class MujocoPhysics(FastPhysics):
    """MuJoCo on every core, with the same model, workers and memory for every population."""

    def __init__(
        self,
        system: MujocoSystem,
        scheme: Scheme,
        dt: float,
        start: Float[np.ndarray, " S"],
        length: int,
        batch: int,
    ):
        self.system = system
        self.scheme = scheme
        self.substeps = scheme.steps(dt)
        self.length = length
        self.steps = self.substeps * length
        self.batch = batch
        self.model = system.model_with(scheme)
        self.start = np.asarray(start, float)
        self.workers = [mujoco.MjData(self.model) for _ in range(core_count())]
        self._alone = mujoco_rollout.Rollout(nthread=0)
        # MuJoCo's state leads with time.
        initial = np.concatenate([[0.0], self.start[: system.physical_size]])
        self._initial = np.tile(initial, (batch, 1))
        self._states = np.empty((batch, self.steps, len(initial)))
        self._sensed: np.ndarray | None = None
        if system.sensors:
            self._sensed = np.empty((batch, self.steps, self.model.nsensordata))

    def rollout(
        self, controls: Float[np.ndarray, "B T C"]
    ) -> tuple[Float[np.ndarray, "G T S L"], Bool[np.ndarray, " B"]]:
        states = self.rollout_float64(controls)
        return _ungrouped(states, self.batch), self.system.has_diverged(states)

    def rollout_float64(self, controls: Float[np.ndarray, "B T C"]) -> Float[np.ndarray, "B T S"]:
        """Return the states after each control, not rounded."""
        count = len(controls)
        kind, signal = self.system.drive(np.asarray(controls, float))
        if count == 1:
            roll = self._alone.rollout
            workers = self.workers[:1]
        else:
            roll = partial(mujoco_rollout.rollout, persistent_pool=True)
            workers = self.workers
        sensed = None if self._sensed is None else self._sensed[:count]
        with warnings_counted:
            roll(
                [self.model] * count,
                workers,
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


class BodyPhysics(FastPhysics):
    """A mass-spring body in C in float32: one body alone, or as many side by side as fill a register."""

    def __init__(
        self,
        system: DeformableSystem,
        alone: CTwin,
        many: CTwin,
        scheme: Scheme,
        dt: float,
        start: Float[np.ndarray, " S"],
        length: int,
        batch: int,
    ):
        self.body = system.body
        self.scheme = scheme
        self.substeps = scheme.steps(dt)
        self.steps = self.substeps * length
        self._alone = alone
        self._many = many
        self._start = np.asarray(start, np.float32)
        self._starts = np.tile(self._start[:, None], many.lanes)
        self._states = np.zeros(
            (batch // SINGLE_LANES, length, len(self._start), SINGLE_LANES), np.float32
        )

    def rollout(
        self, controls: Float[np.ndarray, "B T C"]
    ) -> tuple[Float[np.ndarray, "G T S L"], Bool[np.ndarray, " B"]]:
        if len(controls) == 1:
            states = self._play(self._alone, self._start, controls[0])[None, ..., None]
        else:
            states = self._side_by_side(controls)
        has_diverged = np.asarray(_has_diverged(self.body, states)).ravel()
        return states, has_diverged[: len(controls)]

    def _side_by_side(self, controls: Float[np.ndarray, "B T C"]) -> Float[np.ndarray, "G T S L"]:
        """Return the states of all groups, in the buffer; the last motion fills the last group up."""

        def play_group(number: int) -> None:
            rows = np.arange(number * SINGLE_LANES, (number + 1) * SINGLE_LANES).clip(
                max=len(controls) - 1
            )
            lanes = np.moveaxis(controls[rows], 0, -1)
            self._states[number] = self._play(self._many, self._starts, lanes)

        groups = -(-len(controls) // SINGLE_LANES)
        list(threads().map(play_group, range(groups)))
        return self._states

    def _play(self, twin: CTwin, start: np.ndarray, controls: np.ndarray) -> np.ndarray:
        return twin.play(start, controls, self.scheme.integrator, self.scheme.dt, self.substeps)


class SimulatedPhysics(FastPhysics):
    """Whatever else there is: a soft body, a Python function, or a body where nothing compiles C."""

    def __init__(
        self,
        system: System,
        scheme: Scheme,
        dt: float,
        start: Float[np.ndarray, " S"],
        length: int,
        batch: int,
    ):
        self.system = system
        self.scheme = scheme
        self.dt = dt
        self.steps = scheme.steps(dt) * length
        self.batch = batch
        self._start = np.asarray(start, float)

    def rollout(
        self, controls: Float[np.ndarray, "B T C"]
    ) -> tuple[Float[np.ndarray, "G T S L"], Bool[np.ndarray, " B"]]:
        starts = np.tile(self._start, (len(controls), 1))
        runs = self.system.simulate_fastest(starts, controls, self.dt, self.scheme)
        return _ungrouped(runs.states[:, 1:], self.batch), runs.has_diverged


def _ungrouped(states: Float[np.ndarray, "B T S"], batch: int) -> Float[np.ndarray, "G T S 1"]:
    """Return states in float32 as groups of one lane: one motion alone, more in room for `batch`."""
    count = len(states)
    groups = 1 if count == 1 else batch
    grouped = np.zeros((groups, *states.shape[1:], 1), np.float32)
    with np.errstate(over="ignore"):
        grouped[:count, ..., 0] = states
    return grouped


def fast_physics(
    system: System,
    scheme: Scheme,
    dt: float,
    start: Float[np.ndarray, " S"],
    length: int,
    batch: int = 1,
) -> FastPhysics:
    """Return the physics of motions of `length` super steps of `dt` [s] from `start`.

    Up to `batch` go at a time, a multiple of `side_by_side`.
    """
    if isinstance(system, MujocoSystem):
        return MujocoPhysics(system, scheme, dt, start, length, batch)
    if isinstance(system, DeformableSystem):
        alone = c_twin(system.body, np.float32)
        many = c_twin(system.body, np.float32, SINGLE_LANES)
        if alone and many:
            return BodyPhysics(system, alone, many, scheme, dt, start, length, batch)
    return SimulatedPhysics(system, scheme, dt, start, length, batch)


def side_by_side(system: System) -> int:
    """Return how many motions cost no more time than one of them: the lanes of C, cores, or both."""
    if isinstance(system, SoftSystem):
        return system.scene.lanes * core_count()
    return SINGLE_LANES if isinstance(system, DeformableSystem) else core_count()


def cheapest_scheme(system: System, dt: float, start: Float[np.ndarray, " S"]) -> Scheme:
    """Return the system's `scheme`, or for MuJoCo its `truth` where that is cheaper per second: measured now."""
    if not isinstance(system, MujocoSystem):
        return system.scheme
    schemes = (system.scheme, system.truth)
    controls = sample_controls(np.random.default_rng(0), TRIED_STEPS, dt, system.bounds)[None]
    tried = [MujocoPhysics(system, scheme, dt, start, TRIED_STEPS, 1) for scheme in schemes]
    times = np.empty((TRIES, len(tried)))
    for attempt in range(TRIES):
        for number, physics in enumerate(tried):
            times[attempt, number] = _seconds(physics, controls)
    return schemes[int(times.min(axis=0).argmin())]


def _seconds(physics: MujocoPhysics, controls: Float[np.ndarray, "B T C"]) -> float:
    began = time.perf_counter()
    physics.rollout_float64(controls)
    return time.perf_counter() - began


@cache
def threads() -> ThreadPoolExecutor:
    """Return as many threads as cores, kept."""
    return ThreadPoolExecutor(core_count())


@partial(jax.jit, static_argnums=0)
def _has_diverged(body: Body, states: Float[Array, "G T S L"]) -> Bool[Array, "G L"]:
    """Return whether any of a body's states is not finite, or has a spring stretched far too wide."""
    points = states[:, :, : 3 * len(body.masses)]
    positions = points.reshape(*points.shape[:2], -1, 3, points.shape[-1])
    by_point = jnp.moveaxis(positions, (2, 3), (0, 1))
    is_torn = jnp.abs(strains(body, by_point)) > MAX_STRAIN
    return is_torn.any(axis=(0, 2)) | ~jnp.isfinite(states).all(axis=(1, 2))
