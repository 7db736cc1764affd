"""Contacts are seen where MuJoCo sees them, wherever the body is, and go through files and C."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
import pytest

from neuroanimator import DatasetConfig, Emulator, TrainingConfig, load_system
from neuroanimator.emulator.description import blank, describe
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.physics.loading import trust_files
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.contacts import Contacts
from neuroanimator.state.rotation import facing, multiply, rotate
from neuroanimator.systems.system import System

ROBOT = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body pos="0 0 0.8">
      <freejoint name="root"/>
      <geom type="box" size="0.2 0.1 0.05"/>
      <body pos="0.2 0.05 0">
        <joint name="hip" type="hinge" axis="0 1 0" pos="0.02 0 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03"/>
        <body pos="0 0 -0.3" quat="0.9 0.1 0 0.1">
          <joint name="knee" type="hinge" axis="0 0.6 0.8" range="-90 5" ref="10"/>
          <geom type="cylinder" size="0.04 0.1" pos="0 0 -0.1"/>
          <body pos="0 0 -0.25">
            <geom type="sphere" size="0.05"/>
          </body>
        </body>
      </body>
      <body pos="-0.2 0 0">
        <joint name="wrist" type="ball" pos="0 0.02 0"/>
        <geom type="ellipsoid" size="0.05 0.08 0.1" pos="0 0 -0.2"/>
        <body pos="0 0 -0.35">
          <joint name="slide" type="slide" axis="0 0 1" range="-0.1 0.1"/>
          <geom type="box" size="0.03 0.04 0.05"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="hip" joint="hip" ctrlrange="-1 1"/>
    <motor name="knee" joint="knee" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""

TOML = """
name = "robot"
model = "robot.xml"
substeps = 4
physics = { step = 0.005, truth_step = 0.005, fine_step = 0.0005 }
frame = { ground = true, contacts = true }

[sampling]
tilt = 0.6
height = [-0.5, 0.2]
position = { hip = 1.0, knee = 1.0, wrist = 0.8, slide = 0.2 }

[sampling.velocity]
root = [1, 1, 1, 2, 2, 2]
hip = [3]
knee = [3]
wrist = [2, 2, 2]
slide = [1]
"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> System:
    folder = tmp_path_factory.mktemp("robot")
    (folder / "robot.xml").write_text(ROBOT)
    (folder / "robot.toml").write_text(TOML)
    trust_files(folder / "robot.toml")
    return load_system(str(folder / "robot.toml"))


@pytest.fixture(scope="module")
def fresh(robot: System) -> Emulator:
    data = simulate_transitions(
        DatasetConfig(
            system="robot",
            definition=robot.definition_text,
            substeps=4,
            count=612,
            samples_per_run=36,
        )
    )
    return build_emulator(data, TrainingConfig(widths=(24, 16)))


def described(emulator: Emulator) -> dict[str, Any]:
    """Return what a file says of it."""
    return json.loads(json.dumps(describe(emulator)))


def contacts_of(system: System) -> Contacts:
    contacts = system.structure.contacts
    assert contacts is not None
    return contacts


def test_points_are_where_mujocos_bodies_are(robot):
    contacts = contacts_of(robot)
    states = robot.sample_starts(np.random.default_rng(0), 30)
    transforms = contacts.kinematics.transforms(states)
    data = mujoco.MjData(robot.model)
    for row, state in enumerate(states):
        robot.put(data, state)
        mujoco.mj_kinematics(robot.model, data)
        for body in range(1, robot.model.nbody):
            frame, matrix = contacts.kinematics.carried[body]
            found = transforms[frame][row] @ matrix
            np.testing.assert_allclose(found[:3, 3], data.xpos[body], atol=1e-9)
            np.testing.assert_allclose(found[:3, :3].ravel(), data.xmat[body], atol=1e-9)


def test_the_lowest_point_is_as_deep_as_mujocos_deepest_contact(robot):
    """Of capsules, spheres and boxes exactly; rims and ellipsoids are a few points, which are never too low."""
    contacts = contacts_of(robot)
    states = robot.sample_starts(np.random.default_rng(1), 300)
    lowest = contacts.heights(contacts.centres(states)).min(axis=1)
    data = mujoco.MjData(robot.model)
    depths = []
    for state in states:
        robot.put(data, state)
        mujoco.mj_forward(robot.model, data)
        ground = (data.contact.geom == 0).any(axis=1)
        depths.append(min(data.contact.dist[ground], default=0.0))
    depths = np.array(depths)
    assert (depths < -0.01).sum() > 20
    assert (lowest > depths - 1e-6).all()
    np.testing.assert_allclose(np.minimum(lowest, 0), depths, atol=0.04)


def test_coasting_is_mujocos(robot):
    contacts = contacts_of(robot)
    states = robot.sample_starts(np.random.default_rng(2), 30)
    coasted = contacts.coasted(states, 1e-3)
    for state, later in zip(states, coasted, strict=True):
        positions = state[: robot.model.nq].copy()
        mujoco.mj_integratePos(robot.model, positions, state[robot.model.nq :], 1e-3)
        np.testing.assert_allclose(later[: robot.model.nq], positions, atol=1e-8)


def test_what_is_shown_does_not_tell_position_or_heading(robot):
    frame = Frame.of(robot.structure, 0.02)
    rng = np.random.default_rng(3)
    states = robot.sample_starts(rng, 50)
    heading = facing(rng.uniform(-3, 3, 50))
    moved = states.copy()
    moved[:, :3] = rotate(heading, states[:, :3]) + rng.normal(size=(50, 3)) * [100, 100, 0]
    moved[:, 3:7] = multiply(heading, states[:, 3:7])
    velocity = robot.state.index("root.velocity")
    moved[:, velocity] = rotate(heading, states[:, velocity])
    np.testing.assert_allclose(frame.local(moved), frame.local(states), atol=1e-9)


def test_jax_and_numpy_show_the_same(robot):
    frame = Frame.of(robot.structure, 0.02)
    states = robot.sample_starts(np.random.default_rng(4), 20)
    shown = jax.jit(frame.local)(states.astype(np.float32))
    assert shown.shape == (20, frame.local_size)
    np.testing.assert_allclose(shown, frame.local(states), atol=1e-5)


def test_a_joint_within_its_range_is_past_no_stop(robot):
    contacts = contacts_of(robot)
    state = robot.rest[None].repeat(3, axis=0)
    hip = robot.state.index("hip").start
    state[:, hip] = [-2.0, 0.0, 2.0]
    past, _ = contacts._past_stops(state, 0.0)
    assert past[0, 0] > 0.5
    assert abs(past[1, 0]) < 0.01
    assert past[2, 0] < -0.5


def test_points_that_are_always_one_are_shown_once(robot):
    contacts = contacts_of(robot)
    states = robot.sample_starts(np.random.default_rng(5), 100)
    centres = contacts.centres(states)
    count = centres.shape[-1]
    for first in range(count):
        for second in range(first):
            apart = np.linalg.norm(centres[:, :, first] - centres[:, :, second], axis=1)
            assert apart.max() > 1e-3, (contacts.points[first], contacts.points[second])


def test_contacts_go_through_the_file_and_through_c(robot, tmp_path: Path, fresh):
    again = blank(described(fresh), Emulator)
    assert again.frame.contacts == fresh.frame.contacts
    fresh.save(tmp_path / "robot.safetensors")
    loaded = Emulator.load(tmp_path / "robot.safetensors")
    states = robot.sample_starts(np.random.default_rng(6), 10)
    controls = np.zeros((10, 2))
    in_c = np.stack([loaded.step(s, c) for s, c in zip(states, controls, strict=True)])
    in_jax = jax.jit(jax.vmap(loaded.step))(states.astype(np.float32), controls.astype(np.float32))
    np.testing.assert_allclose(in_c, in_jax, atol=1e-4)


@pytest.mark.parametrize(
    "spoiled",
    [
        {"points": [[99, 0, 0, 0, 0.1]]},
        {"points": [[2, 0, 0, float("nan"), 0.1]]},
        {"points": [[2, 0, 0, 0, 0.1]] * 65},
        {"planes": []},
        {"planes": [[0, 0, 2, 0]]},
        {"stops": [[3, -1, 1]]},
        {"stops": [[7, 1, -1]]},
        {"axes": [3]},
        {"placeless": [3]},
    ],
)
def test_contacts_no_body_has_are_refused(spoiled, fresh):
    metadata = described(fresh)
    metadata["contacts"] = {**metadata["contacts"], **spoiled}
    with pytest.raises(ValueError, match="contacts"):
        blank(metadata, Emulator)


def test_what_has_no_ground_and_no_stops_shows_nothing(robot):
    structure = replace(robot.structure, contacts=None)
    assert Frame.of(structure, 0.02).local_size < Frame.of(robot.structure, 0.02).local_size


def test_the_usual_settings_of_a_body_with_contacts_give_way_to_the_users(robot: System):
    usual = TrainingConfig.usual(robot.structure)
    assert usual.widths != TrainingConfig().widths
    own = TrainingConfig.usual(robot.structure, updates=250)
    assert own == usual.model_copy(update={"updates": 250})
