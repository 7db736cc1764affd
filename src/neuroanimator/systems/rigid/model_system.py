"""A system made from a definition and a MuJoCo model: ours and anybody's own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from neuroanimator.definitions.goal import GoalTable
from neuroanimator.definitions.model import Definition
from neuroanimator.errors import ArgumentError
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.rotation import facing, multiply, rotate, rotated_by
from neuroanimator.systems.goal import Goal, goal_at
from neuroanimator.systems.rigid.bones import skeleton_of
from neuroanimator.systems.rigid.joints import (
    JointView,
    actuator_name,
    joint_views,
    sensor_numbers,
    state_layout,
    structure_of,
)
from neuroanimator.systems.rigid.limbs import groups_of
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.rigid.warnings import warnings_counted
from neuroanimator.systems.system import Scheme

HOME = "home"
"""Keyframe that is the state of rest, if the model has one of this name."""


class ModelSystem(MujocoSystem):
    """A MuJoCo model as its definition says it should be seen, driven and sampled."""

    def __init__(self, definition: Definition, model: mujoco.MjModel, text: str = ""):
        """`text` is what the system can be made from again; empty for one that comes with the package."""
        self.name, self.definition, self.model = definition.name, text, model
        self.views = joint_views(model, dict(definition.state), definition.frame.planar)
        self.sensors = sensor_entries(model, definition.sensors)
        self.state = state_layout(model, self.views, definition.sensors)
        self.control, self.bounds = _controls(model, definition)
        structure = structure_of(model, self.views, definition.frame, self.control, self.state.size)
        self.structure = replace(structure, groups=groups_of(model, self.views, definition.groups))
        physics = definition.physics
        self.scheme = Scheme(physics.integrator, physics.step)
        self.truth = Scheme(physics.truth_integrator, physics.truth_step)
        self.fine = Scheme(physics.fine_integrator, physics.fine_step)
        self.skeleton = skeleton_of(model)
        self.rest = self.with_sensors(_rest(model)[None])[0]
        self.sampling = definition.sampling
        self.warm_up = definition.sampling.warm_up
        self._check_sampling()
        self.goals = self.goals_of(definition.goals)

    def sample_starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        near = rng.random(count) < self.sampling.rest_share
        spread = np.where(near, self.sampling.rest_spread, 1.0)[:, None]
        starts = np.repeat(self.rest[None], count, axis=0)
        for view in self.views:
            self._scatter(view, starts, spread, rng)
        return self.with_sensors(starts[:, : self.physical_size])

    def start_at(self, parts: Mapping[str, Sequence[float]]) -> np.ndarray:
        """Return the start `parts` name, with what the sensors say in it."""
        start = super().start_at(parts)
        return self.with_sensors(start[None, : self.physical_size])[0]

    def with_sensors(self, physics_states: np.ndarray) -> np.ndarray:
        """Return states (B, S) with what the sensors say in the physical states (B, P)."""
        if not self.sensors:
            return physics_states
        data, sensed = mujoco.MjData(self.model), np.empty((len(physics_states), len(self.sensors)))
        with warnings_counted:
            for row, state in enumerate(physics_states):
                self.put(data, state)
                mujoco.mj_forward(self.model, data)
                sensed[row] = data.sensordata[list(self.sensors)]
        return np.concatenate([physics_states, sensed], axis=1)

    def _scatter(
        self, view: JointView, starts: np.ndarray, spread: np.ndarray, rng: np.random.Generator
    ) -> None:
        count, sampling = len(starts), self.sampling
        velocities = np.array(sampling.velocity.get(view.name, ()))
        drawn = rng.normal(size=(count, len(velocities))) * velocities * spread
        if view.kind == "free":
            orientation = slice(view.position_entry + 3, view.position_entry + 7)
            heading = facing(rng.uniform(-np.pi, np.pi, count))
            turned = rotated_by(
                starts[:, orientation],
                rng.normal(size=(count, 3)) * [1, 1, 0] * sampling.tilt * spread,
            )
            starts[:, orientation] = multiply(heading, turned)
            starts[:, view.position_entry + 2] += (
                rng.uniform(*sampling.height, count) * spread[:, 0]
            )
            if len(velocities):
                starts[:, view.rate : view.rate + 3] = rotate(starts[:, orientation], drawn[:, :3])
                starts[:, view.rate + 3 : view.rate + 6] = drawn[:, 3:]
            return
        width = sampling.position.get(view.name, 0.0)
        if view.kind == "ball":
            orientation = slice(view.position_entry, view.position_entry + 4)
            starts[:, orientation] = rotated_by(
                starts[:, orientation], rng.normal(size=(count, 3)) * width * spread
            )
        else:
            starts[:, view.position_entry] += (rng.uniform(-1, 1, count) * width) * spread[:, 0]
        starts[:, view.rate : view.rate + len(velocities)] = drawn

    def _check_sampling(self) -> None:
        sizes = {view.name: {"free": 6, "ball": 3}.get(view.kind, 1) for view in self.views}
        for table in ("position", "velocity"):
            for name, value in getattr(self.sampling, table).items():
                if name not in sizes:
                    raise ArgumentError(
                        f"sampling.{table}: no joint called '{name}'. Joints: {', '.join(sizes)}."
                    )
                if table == "velocity" and len(value) != sizes[name]:
                    raise ArgumentError(
                        f"sampling.velocity.{name}: wanted {sizes[name]} numbers, came {len(value)}."
                    )

    def goal(self, name: str, table: GoalTable) -> Goal:
        """Return the goal that `table` describes; ArgumentError names `name` and the part that is wrong."""
        reach = {part: np.array(values, float) for part, values in table.reach.items()}
        if table.site:
            reach |= self._at_site(name, table.site)
        return goal_at(
            name,
            table,
            {part: self._entries(name, part, numbers) for part, numbers in reach.items()},
        )

    def _at_site(self, name: str, site: str) -> dict[str, np.ndarray]:
        sites = [self.model.site(i).name for i in range(self.model.nsite)]
        if self.views[0].kind != "free" or site not in sites:
            raise ArgumentError(
                f"goals.{name}.site: no site '{site}', or no free root. Sites: {', '.join(sites)}."
            )
        data, root = mujoco.MjData(self.model), self.views[0].name
        mujoco.mj_kinematics(self.model, data)
        orientation = np.empty(4)
        mujoco.mju_mat2Quat(orientation, data.site(site).xmat)
        at_rest = {f"{root}.velocity": np.zeros(3), f"{root}.angular_velocity": np.zeros(3)}
        return {
            f"{root}.position": np.array(data.site(site).xpos),
            f"{root}.orientation": orientation,
            **at_rest,
        }

    def _entries(self, name: str, part: str, numbers: np.ndarray) -> tuple[list[int], np.ndarray]:
        """Return the state entries of a part, and its numbers; `<root>.heading` stands for the root's turn."""
        if part.endswith(".heading"):
            part, numbers = part.removesuffix(".heading") + ".orientation", facing(numbers[0])
        position = self.state.index(part)
        entries = list(range(position.start, position.stop))[: len(numbers)]
        if len(entries) < len(numbers) or (part.endswith(".orientation") and len(numbers) != 4):
            raise ArgumentError(
                f"goals.{name}.reach: '{part}' has {position.stop - position.start} numbers."
            )
        return entries, numbers


def sensor_entries(model: mujoco.MjModel, names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the entries of MuJoCo's sensor data the sensors called `names` fill."""
    positions = [
        (int(model.sensor_adr[i]), int(model.sensor_dim[i])) for i in sensor_numbers(model, names)
    ]
    return tuple(start + i for start, size in positions for i in range(size))


def _controls(model: mujoco.MjModel, definition: Definition) -> tuple[Layout, Bounds]:
    """Return the actuators as a control vector, with bounds from the definition or the model."""
    names = [actuator_name(model, i) for i in range(model.nu)]
    for name in definition.control:
        if name not in names:
            raise ArgumentError(
                f"control: no actuator called '{name}'. Actuators: {', '.join(names)}."
            )
    bounds = [
        definition.control.get(name) or control_range(model, i) for i, name in enumerate(names)
    ]
    for name, bound in zip(names, bounds, strict=True):
        if bound is None or not bound[0] < bound[1]:
            raise ArgumentError(
                f"control.{name}: wanted [least, largest], such as [-1, 1]; the model gives no range."
            )
    low, high = zip(*bounds, strict=True)
    units = [control_unit(model, i) for i in range(model.nu)]
    slices = tuple(Slice(name, 1, unit) for name, unit in zip(names, units, strict=True))
    return Layout(slices), Bounds(tuple(map(float, low)), tuple(map(float, high)))


def control_range(model: mujoco.MjModel, actuator: int) -> tuple[float, float] | None:
    """Return the least and largest control the model allows, or None if it does not say."""
    if not model.actuator_ctrllimited[actuator]:
        return None
    low, high = model.actuator_ctrlrange[actuator]
    return float(low), float(high)


def control_unit(model: mujoco.MjModel, actuator: int) -> str:
    """Return the unit of a control where it is certain, else 1."""
    if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT:
        return "1"
    hinge = model.jnt_type[model.actuator_trnid[actuator][0]] == mujoco.mjtJoint.mjJNT_HINGE
    is_motor = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    is_direct = model.actuator_gainprm[actuator][0] == 1 and model.actuator_gear[actuator][0] == 1
    if is_motor and is_direct and not model.actuator_dyntype[actuator]:
        return "N·m" if hinge else "N"
    gain, bias = model.actuator_gainprm[actuator][0], model.actuator_biasprm[actuator][1]
    is_servo = not is_motor and gain == -bias and model.actuator_gear[actuator][0] == 1
    return ("rad" if hinge else "m") if is_servo else "1"


def _rest(model: mujoco.MjModel) -> np.ndarray:
    """Return (S,) the keyframe `home` if there is one, else the model's reference pose, standing still."""
    data = mujoco.MjData(model)
    names = [model.key(i).name for i in range(model.nkey)]
    if HOME in names:
        mujoco.mj_resetDataKeyframe(model, data, names.index(HOME))
    return np.concatenate([data.qpos, data.qvel, data.act])
