"""Mirrors and like limbs are found in a model, tried on its physics, and shown to the network."""

from __future__ import annotations

import time
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from neuroanimator import load_system
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.training.batches import seen_by
from neuroanimator.physics.loading import trust_files
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.physics.rigid.symmetries import MAX_DISCREPANCY, discrepancy, likely_symmetries
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System

WALKER = """<mujoco><option timestep="0.002"/>
  <default><joint damping="1"/><motor ctrlrange="-1 1" gear="20"/></default>
  <worldbody><geom type="plane" size="9 9 1"/><body name="torso" pos="0 0 0.9">
    <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1" ref="0.9"/>
    <joint name="tilt" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.02 0 0.4" size="0.05"/>
    <body name="left"><joint name="left_hip" axis="0 1 0" damping="{damping}" range="-90 30" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.8" size="{radius}"/></body>
    <body name="right"><joint name="right_hip" axis="0 1 0" range="-90 30" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.8" size="0.04"/></body></body></worldbody>
  <actuator><motor joint="left_hip"/><motor joint="right_hip"/></actuator></mujoco>"""

CRAB = """<mujoco><option timestep="0.002"/>
  <default><joint damping="1"/><default class="knee"><joint range="-50 40" limited="true"/></default>
    <position kp="20" ctrlrange="-1 0.7"/></default>
  <worldbody><geom type="plane" size="9 9 1"/><body name="trunk" pos="0 0 0.4"><freejoint name="root"/>
    <geom type="ellipsoid" size="0.3 0.2 0.1"/>
    <body name="left" pos="0 0.2 0"><joint class="knee" name="left_knee" axis="1 0 0"/>
      <geom type="capsule" fromto="0 0 0 0 0.2 -0.2" size="0.04"/></body>
    <body name="right" pos="0 -0.2 0"><joint class="knee" name="right_knee" axis="-1 0 0"/>
      <geom type="capsule" fromto="0 0 0 0 -0.2 -0.2" size="0.04"/></body>
    <body name="eye" pos="0.3 0 0.1"><joint name="stalk" type="ball" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.02"/></body></body></worldbody>
  <actuator><position joint="left_knee"/><position joint="right_knee"/></actuator></mujoco>"""

CONTROLLED_CRAB = CRAB.replace(
    '<position joint="left_knee"/><position joint="right_knee"/>',
    """<pid joint="left_knee" kp="20" kv="1" ki="1" imax="1" input="pos vel" posrange="-1 0.7" velrange="-2 2"/>
    <dcmotor joint="left_knee" motorconst="0.1" resistance="1" input="none"/>
    <pid joint="right_knee" kp="20" kv="1" ki="1" imax="1" input="pos vel" posrange="-1 0.7" velrange="-2 2"/>
    <dcmotor joint="right_knee" motorconst="0.1" resistance="1" input="none"/>""",
)

DRONE = """<mujoco><option timestep="0.005"/><worldbody>
  <body name="frame" pos="0 0 1"><freejoint name="root"/><geom type="box" size="0.1 0.1 0.02" mass="0.5"/>
    <site name="a" pos="0.1 0.1 0"/><site name="b" pos="-0.1 0.1 0"/>
    <site name="c" pos="-0.1 -0.1 0"/><site name="d" pos="0.1 -0.1 0"/></body></worldbody>
  <actuator><motor site="a" ctrlrange="0 3" gear="0 0 1 0 0 0.02"/><motor site="b" ctrlrange="0 3" gear="0 0 1 0 0 -0.02"/>
    <motor site="c" ctrlrange="0 3" gear="0 0 1 0 0 0.02"/><motor site="d" ctrlrange="0 3" gear="0 0 1 0 0 -0.02"/></actuator>
  </mujoco>"""


def walker(damping: float = 1, radius: float = 0.04) -> str:
    """Return a walker whose left hip has this damping [Nms/rad], its left leg this radius [m]."""
    return WALKER.format(damping=damping, radius=radius)


DEFINITION = """name = "model"
kind = "mujoco"
model = "model.xml"
[physics]
step = {step}
truth_step = {step}
fine_step = {step}
[frame]
symmetries = true
[sampling]
warm_up = 1.0
"""
"""A definition that claims symmetries; what `new` proposes claims them where it finds them, and takes longer."""


def claiming(folder: Path, model: str) -> ModelSystem:
    """Return the system of `model`, which is said to have symmetries."""
    (folder / "model.xml").write_text(model)
    step = mujoco.MjModel.from_xml_string(model).opt.timestep
    toml = folder / "claiming.toml"
    toml.write_text(DEFINITION.format(step=step))
    trust_files(toml)
    system = load_system(str(toml))
    assert isinstance(system, ModelSystem)
    return system


def some(system: System, count: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Return states and controls as they occur."""
    rng = np.random.default_rng(3)
    starts = sample_starts(system, rng, count)
    return starts, sample_control_runs(rng, count, 1, system.physics_dt, system)[:, 0]


@pytest.mark.parametrize(
    ("model", "count"),
    [(walker(), 1), (CRAB, 1), (CONTROLLED_CRAB, 1), (DRONE, 3)],
    ids=["walker", "crab", "crab of several controls", "drone"],
)
def test_every_symmetry_found_makes_true_motions_of_true_ones(
    tmp_path: Path, model: str, count: int
):
    system = claiming(tmp_path, model)
    states, controls = some(system)
    found = system.symmetries(states, controls)
    assert len(found) == count
    for symmetry in found:
        assert not symmetry.is_identity
        # Mirrors, half turns and exchanges undo themselves.
        np.testing.assert_array_equal(symmetry.state(symmetry.state(states)), states)
        assert discrepancy(system, symmetry, states, controls) < MAX_DISCREPANCY / 10


def test_a_heavier_leg_is_no_like_leg():
    heavier = walker(radius=0.05)
    assert len(likely_symmetries(mujoco.MjModel.from_xml_string(walker()))) == 1
    assert likely_symmetries(mujoco.MjModel.from_xml_string(heavier)) == ()


def test_a_tangle_of_like_things_is_given_up_soon():
    """Equal pendulums in one place, the last of them with its bob on one side: in a mirror, pairings without end all fail."""
    pendulum = (
        '<body><joint axis="0 1 0"/><geom type="sphere" size="0.1"/>'
        '<body pos="0 {} -1"><joint axis="0 1 0"/><geom type="sphere" size="0.05"/></body></body>'
    )
    tangle = "".join(pendulum.format(side) for side in [0.0] * 14 + [0.3])
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{tangle}</worldbody></mujoco>")
    began = time.process_time()
    assert all(symmetry.entries[14] == 14 for symmetry in likely_symmetries(model))
    assert time.process_time() - began < 20


def test_three_like_limbs_change_places_in_every_way(tmp_path: Path):
    """Two of the five ways lead all three on: done twice they do not lead back."""
    limb = (
        '<body><joint name="{0}" axis="0 1 0" damping="0.1"/>'
        '<geom type="capsule" fromto="0 0 0 0.1 0 -1" size="0.05" contype="0" conaffinity="0"/></body>'
    )
    limbs = "".join(limb.format(name) for name in "abc")
    motors = "".join(f'<motor joint="{name}" ctrlrange="-1 1"/>' for name in "abc")
    system = claiming(
        tmp_path,
        f"<mujoco><worldbody>{limbs}</worldbody><actuator>{motors}</actuator></mujoco>",
    )
    assert len(system.symmetries(*some(system))) == 5


def test_what_only_the_physics_tells_apart_is_not_believed(tmp_path: Path):
    model = walker(damping=3)
    assert len(likely_symmetries(mujoco.MjModel.from_xml_string(model))) == 1
    system = claiming(tmp_path, model)
    assert system.symmetries(*some(system)) == ()


@pytest.mark.parametrize(
    ("damping", "has_symmetries"),
    [(1, True), pytest.param(3, False, marks=pytest.mark.endurance)],
)
def test_new_claims_the_symmetries_it_finds(tmp_path: Path, damping: int, has_symmetries: bool):
    (tmp_path / "model.xml").write_text(walker(damping))
    toml, _ = write_definition(str(tmp_path / "model.xml"))
    assert f"symmetries = {str(has_symmetries).lower()}" in toml.read_text()


def test_training_sees_each_window_whole_and_by_every_symmetry(tmp_path: Path):
    system = claiming(tmp_path, DRONE)
    starts, controls = some(system, 1)
    symmetries = system.symmetries(*some(system))
    runs = system.simulate(starts, controls[:, None].repeat(3, axis=1), 10 * system.physics_dt)
    windows = np.repeat(runs.states, 64, axis=0)
    driven = np.repeat(controls[:, None].repeat(3, axis=1), 64, axis=0)
    states, shown = seen_by(
        symmetries, jax.random.key(0), jnp.asarray(windows), jnp.asarray(driven)
    )
    views = [runs.states[0], *(symmetry.state(runs.states[0]) for symmetry in symmetries)]
    for window, control in zip(np.asarray(states), np.asarray(shown), strict=True):
        which = int(np.argmin([np.abs(window - view).max() for view in views]))
        np.testing.assert_allclose(window, views[which], rtol=1e-6, atol=1e-7)
        wanted = driven[0] if which == 0 else symmetries[which - 1].control(driven[0])
        np.testing.assert_allclose(control, wanted, rtol=1e-6)
    seen = {tuple(window[-1]) for window in np.asarray(states).round(5)}
    assert len(seen) == len(views)
