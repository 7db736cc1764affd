"""Rigid bodies: a System with MuJoCo's physics."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import get_args

import mujoco
import numpy as np
from mujoco import rollout

from neuroanimator.definitions.model import Integrator
from neuroanimator.emulator.spec import MAX_GAIN, Engine
from neuroanimator.errors import BadFileError
from neuroanimator.physics.rigid.model_parameters import Family
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.systems.named_files import shipped_folder
from neuroanimator.systems.system import Scheme, System

INTEGRATORS = {
    name: getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}") for name in get_args(Integrator)
}
"""MuJoCo's integrators by their names in definitions."""

DIVERGED_VELOCITY = 1e3
"""Joint velocity above which a motion has diverged [rad/s or m/s]: a hundred times that of starts and motors."""

STEPS_IN_PART = 128
"""Minimum number of physics steps in a part, if there are enough: each part costs some tenths of a millisecond."""

STEPS_IN_MEMORY = 2_000_000
"""Maximum number of physics steps kept at once while simulating, which bounds memory to about 150 MB."""

MODELS_IN_MEMORY = 2**29
"""Maximum total size of models kept at once while bodies of a family are simulated [bytes]."""

ARENA_KEPT = 2**24
"""Maximum used part of MuJoCo's working memory with which it is kept for other runs [bytes]."""

PARTS = 4
"""Number of parts per thread for many runs: some take longer than others."""


def load_model(file_name: str) -> mujoco.MjModel:
    """Return the model of a shipped MJCF file."""
    with shipped_folder() as folder:
        return mujoco.MjModel.from_xml_path(str(folder / file_name))


class MujocoSystem(System):
    """A MuJoCo model whose state is (qpos, qvel, act, sensors, parameters), driven by motors or by forces on its bodies.

    Sensors are MuJoCo's readings at the last physics step. They are emulated like the rest, but do not affect
    the motion. Parameters stay constant.

    Subclasses set the fields of `System`, `model`, and `external_forces`: per control a (body, axis) pair
    naming the world-frame force it is [N]; empty if the controls are the model's own actuators.
    """

    model: mujoco.MjModel
    external_forces: tuple[tuple[str, int], ...] = ()
    sensors: tuple[int, ...] = ()
    """Entries of MuJoCo's sensor data that belong to the state."""
    family: Family | None = None
    """The models of bodies that differ in parameters; None for a single body."""

    @cached_property
    def _idle(self) -> list[mujoco.MjData]:
        """Working memory not in use: allocating it takes longer than stepping a few bodies."""
        return []

    @property
    def engine(self) -> Engine:
        """MuJoCo's release, and the gains of the actuators as it has compiled them."""
        model = self.model
        feedback = model.actuator_biasprm[:, 1:3]
        gains = np.column_stack([model.actuator_gainprm[:, 0], -feedback])
        cut = np.clip(gains, -MAX_GAIN, MAX_GAIN).ravel()
        return Engine(mujoco.__version__, tuple(cut.tolist()))

    @property
    def physical_size(self) -> int:
        """Number of state entries of positions, velocities and activations: all but the sensors and parameters."""
        return self.model.nq + self.model.nv + self.model.na

    @cached_property
    def integrators(self) -> tuple[str, ...]:
        """The integrators that can step this model: MuJoCo refuses some under some of its flags."""
        return tuple(name for name in INTEGRATORS if self._can_step(name))

    def _can_step(self, integrator: str) -> bool:
        model = self.model_with(Scheme(integrator, self.physics_dt))
        try:
            with warnings_counted:
                mujoco.mj_step(model, mujoco.MjData(model))
        except BadFileError:
            return False
        return True

    def model_of(self, state: np.ndarray, like: mujoco.MjModel | None = None) -> mujoco.MjModel:
        """Return the model, or a copy of one `like` it, with the parameters in the `state` (S,)."""
        model = like or self.model
        if self.family is None:
            return model
        return self.family.model_at(state[self.parameter_entries], model)

    def model_with(self, scheme: Scheme) -> mujoco.MjModel:
        """Return a copy of the model that steps by `scheme`."""
        model = self.model.__copy__()
        model.opt.timestep = scheme.dt
        model.opt.integrator = INTEGRATORS[scheme.integrator]
        return model

    def _simulate(
        self,
        states: np.ndarray,
        controls: np.ndarray,
        scheme: Scheme,
        substeps: int,
        threads: int,
    ) -> None:
        model = self.model_with(scheme)
        steps = substeps * max(1, controls.shape[1])
        in_memory = max(1, STEPS_IN_MEMORY // (steps * threads))
        shared = -(-len(states) // (PARTS * threads))
        rows = min(in_memory, max(shared, -(-STEPS_IN_PART // steps), 1))
        if self.family is not None:
            rows = max(1, min(rows, MODELS_IN_MEMORY // (model.nbuffer * threads)))
        parts = [slice(first, first + rows) for first in range(0, len(states), rows)]

        def fill(part: slice) -> None:
            states[part, 1:] = self._rollout(model, states[part, 0], controls[part], substeps)

        if threads == 1 or len(parts) == 1:
            for part in parts:
                fill(part)
            return
        # Python's threads: a FatalError in MuJoCo's own threads would end the process.
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(fill, parts))

    def has_diverged(self, states: np.ndarray) -> np.ndarray:
        """Return whether each run (B, T+1, S) is not finite or impossibly fast."""
        velocities = np.abs(states[..., self.model.nq : self.model.nq + self.model.nv])
        is_finite = np.isfinite(states).all(axis=(1, 2))
        is_slow = (velocities < DIVERGED_VELOCITY).all(axis=(1, 2))
        return np.asarray(~(is_finite & is_slow))

    def kinetic_energies(self, states: np.ndarray) -> np.ndarray:
        energies = np.empty(len(states))
        with warnings_counted:
            for row, (model, data) in enumerate(self._placed(states)):
                mujoco.mj_fwdPosition(model, data)
                mujoco.mj_energyVel(model, data)
                energies[row] = data.energy[1]
        return energies

    def contact_counts(self, states: np.ndarray) -> np.ndarray:
        counts = np.empty(len(states), int)
        with warnings_counted:
            for row, (model, data) in enumerate(self._placed(states)):
                mujoco.mj_kinematics(model, data)
                mujoco.mj_collision(model, data)
                counts[row] = data.ncon
        return counts

    def _placed(self, states: np.ndarray) -> Iterator[tuple[mujoco.MjModel, mujoco.MjData]]:
        """Yield the model of each of `states` (N, S), and data in that state, always the same."""
        data = mujoco.MjData(self.model)
        for state in states:
            self.put(data, state)
            yield self.model_of(state), data

    def put(self, data: mujoco.MjData, state: np.ndarray) -> None:
        """Set the state of `data` to `state` (S,)."""
        mujoco.mj_resetData(self.model, data)
        velocities = self.model.nq
        activations = self.model.nq + self.model.nv
        data.qpos[:] = state[:velocities]
        data.qvel[:] = state[velocities:activations]
        data.act[:] = state[activations : self.physical_size]

    def _rollout(
        self,
        model: mujoco.MjModel,
        starts: np.ndarray,
        controls: np.ndarray,
        substeps: int,
    ) -> np.ndarray:
        """Return the states (B, T, S) after each of `controls` (B, T, C), by steps of `model`."""
        physics_states = starts[:, : self.physical_size]
        time = np.zeros((len(starts), 1))  # MuJoCo's state begins with time
        initial = np.concatenate([time, physics_states], axis=1)
        kind, signal = self.drive(controls)
        signal = np.repeat(signal, substeps, axis=1)
        models: mujoco.MjModel | list[mujoco.MjModel] = model
        if self.family is not None:
            models = self._models_of(starts, model)
        # Its earlier use does not matter: MuJoCo's rollouts set the whole state.
        data = self._taken(model)
        with warnings_counted:
            physics, readings = rollout.rollout(
                models, data, initial, signal, control_spec=int(kind)
            )
        if data.maxuse_arena <= ARENA_KEPT:
            self._idle.append(data)
        ends = slice(substeps - 1, None, substeps)
        states = np.asarray(physics)[:, ends, 1:]
        sensed = np.asarray(readings)[:, ends]
        parameters = starts[:, None, self.parameter_entries]
        unchanged = np.repeat(parameters, states.shape[1], axis=1)
        return np.concatenate([states, sensed[..., list(self.sensors)], unchanged], axis=-1)

    def _taken(self, model: mujoco.MjModel) -> mujoco.MjData:
        """Return working memory for a rollout of `model`."""
        try:
            return self._idle.pop()
        except IndexError:
            return mujoco.MjData(model)

    def _models_of(self, starts: np.ndarray, model: mujoco.MjModel) -> list[mujoco.MjModel]:
        """Return the model of each of `starts` (B, S), a copy of `model`, shared by starts of the same body."""
        values = starts[:, self.parameter_entries]
        _, firsts, bodies = np.unique(values, axis=0, return_index=True, return_inverse=True)
        models = [self.model_of(starts[first], model) for first in firsts]
        return [models[body] for body in bodies.reshape(-1)]

    def drive(self, controls: np.ndarray) -> tuple[mujoco.mjtState, np.ndarray]:
        """Return the part of MuJoCo's input that the controls set, and its values."""
        if not self.external_forces:
            return mujoco.mjtState.mjSTATE_CTRL, controls
        wrenches = np.zeros((*controls.shape[:2], self.model.nbody, 6))
        for entry, (body, axis) in enumerate(self.external_forces):
            wrenches[:, :, self.model.body(body).id, axis] = controls[..., entry]
        return mujoco.mjtState.mjSTATE_XFRC_APPLIED, wrenches.reshape(*controls.shape[:2], -1)
