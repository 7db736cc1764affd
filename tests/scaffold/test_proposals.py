"""What `new` proposes for models nobody here wrote: laws of every proposal, and of what holds, turns and falls."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator import NeuroAnimatorError, load_system
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.scaffold.holding import at
from neuroanimator.scaffold.model import Proposal, propose
from neuroanimator.scaffold.motion import MAX_TURN
from neuroanimator.scaffold.trials import fastest_turning, run_trial
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.state.layout import Bounds


def drone(keyframe: str = "") -> str:
    corners = [(-0.14, -0.18), (-0.14, 0.18), (0.14, 0.18), (0.14, -0.18)]
    sites = "".join(f'<site name="s{i}" pos="{x} {y} 0.05"/>' for i, (x, y) in enumerate(corners))
    motors = "".join(
        f'<motor site="s{i}" gear="0 0 1 0 0 {(-1) ** i * 0.02}" ctrllimited="true" ctrlrange="0 13"/>'
        for i in range(4)
    )
    return (
        '<mujoco><option timestep="0.01"/><worldbody><body name="drone" pos="0 0 1"><freejoint name="root"/>'
        '<inertial pos="0 0 0" mass="1.325" diaginertia="0.0365 0.0292 0.0604"/>'
        f'<geom size="0.1"/>{sites}</body></worldbody><actuator>{motors}</actuator>{keyframe}</mujoco>'
    )


ARM = """<mujoco><compiler angle="radian"/><option timestep="0.005" integrator="implicitfast"/><worldbody>
  <body><joint name="shoulder" axis="0 1 0" range="-0.5 2" limited="true" damping="0.3"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="1"/>
    <body pos="0.4 0 0"><joint name="elbow" axis="0 1 0" range="0.2 2.5" limited="true" damping="0.2" ref="0.5"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.5"/></body></body>
  </worldbody><actuator><motor joint="shoulder" ctrllimited="true" ctrlrange="-8 8"/>
  <motor joint="elbow" ctrllimited="true" ctrlrange="-3 3"/></actuator>
  <keyframe><key name="out" qpos="0.4 1"/><key name="up" qpos="-0.4 0.3"/></keyframe></mujoco>"""

CRAWLER = """<mujoco><compiler angle="radian"/><option timestep="0.004"/><worldbody>
  <geom name="floor" type="plane" size="5 5 1"/>
  <body name="trunk" pos="0 0 0.25"><freejoint name="root"/><geom type="box" size="0.2 0.1 0.05" mass="3"/>
    <body pos="0.2 0 0"><joint name="front" axis="0 1 0" range="-1 1" limited="true" damping="0.5"/>
      <geom type="box" pos="0 0 -0.1" size="0.03 0.1 0.1" mass="0.4"/></body>
    <body pos="-0.2 0 0"><joint name="back" axis="0 1 0" range="-1 1" limited="true" damping="0.5"/>
      <geom type="box" pos="0 0 -0.1" size="0.03 0.1 0.1" mass="0.4"/></body></body>
  </worldbody><actuator><position joint="front" kp="40" ctrllimited="true" ctrlrange="-0.6 0.6"/>
  <position joint="back" kp="40" ctrllimited="true" ctrlrange="-0.6 0.6"/></actuator></mujoco>"""


def written(folder: Path, xml: str) -> tuple[ModelSystem, Proposal]:
    (folder / "mine.xml").write_text(xml)
    path, proposal = write_definition(str(folder / "mine.xml"))
    system = load_system(str(path))
    assert isinstance(system, ModelSystem)
    return system, proposal


def test_a_model_with_feet_starts_within_the_joints_ranges_and_turns_slowly(tmp_path: Path):
    check_starts_and_turning(*written(tmp_path, CRAWLER))


def check_starts_and_turning(system: ModelSystem, proposal: Proposal) -> None:
    """Assert what every proposal keeps to."""
    starts = system.sample_starts(np.random.default_rng(0), 300)
    for view in system.views:
        if system.model.jnt_limited[view.index]:
            low, high = system.model.jnt_range[view.index]
            positions = starts[:, view.position_entry]
            assert low - 1e-4 <= positions.min()
            assert positions.max() <= high + 1e-4
            # Not about rest alone: what the joint can do is covered.
            assert np.ptp(positions) > 0.3 * (high - low)
    trial = run_trial(system, proposal.definition.substeps)
    _, speed = fastest_turning(system, trial)
    assert trial.diverged == 0
    assert speed * trial.dt <= MAX_TURN
    assert proposal.definition.substeps > 1
    if proposal.definition.sampling.above_ground:
        assert deepest_contact(system, starts[:50]) < 1e-3


def deepest_contact(system: ModelSystem, states: np.ndarray) -> float:
    """Return how deep anything lies in the world in any of the states [m]."""
    data = mujoco.MjData(system.model)
    deepest = 0.0
    for state in states:
        system.put(data, state)
        mujoco.mj_fwdPosition(system.model, data)
        depths = [-contact.dist for contact in data.contact if 0 in contact.geom]
        deepest = max(depths, default=deepest)
    return deepest


def test_a_drones_controls_hover_in_the_middle(tmp_path: Path):
    system, proposal = written(tmp_path, drone())
    check_starts_and_turning(system, proposal)
    data = at(system.model, system.rest, system.bounds.middle)
    assert np.abs(data.qacc).max() < 0.05
    assert any("there is no floor" in warning for warning in proposal.warnings)
    assert "holds it" in (tmp_path / "mine.toml").read_text()
    # Where its controls cease it goes on hovering, as nobody lets a drone fall.
    idle = np.tile(system.bounds.idle, (1, 20, 1))
    states = system.simulate(system.rest[None], idle, 0.05).states[0]
    assert np.abs(states - system.rest).max() < 1e-3
    bounds = Bounds.from_json(system.bounds.to_json(), 4, "bounds")
    assert bounds == system.bounds
    text = (tmp_path / "mine.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace("actuator_0 = 3.2", "actuator_0 = 99.2"))
    with pytest.raises(NeuroAnimatorError, match="holding.actuator_0: wanted 1.6"):
        load_system(str(tmp_path / "mine.toml"))


def test_what_no_control_holds_and_no_floor_stops_is_said_to_fall_for_ever(tmp_path: Path):
    weak = drone().replace('ctrlrange="0 13"', 'ctrlrange="0 1"')
    _, proposal = written(tmp_path, weak)
    assert any("falls forever" in warning for warning in proposal.warnings)
    flag = weak.replace('"0.01"/>', '"0.01"><flag gravity="disable"/></option>')
    (tmp_path / "mine.toml").unlink()
    _, proposal = written(tmp_path, flag)
    assert not proposal.warnings


def test_any_keyframe_may_be_the_state_of_rest(tmp_path: Path):
    (tmp_path / "arm.xml").write_text(ARM)
    path, proposal = write_definition(str(tmp_path / "arm.xml"), keyframe="up")
    system = load_system(str(path))
    assert isinstance(system, ModelSystem)
    np.testing.assert_allclose(system.rest[:2], [-0.4, 0.3])
    check_starts_and_turning(system, proposal)
    with pytest.raises(NeuroAnimatorError, match="no keyframe called 'down'. Keyframes: out, up"):
        propose(tmp_path / "arm.xml", keyframe="down")


def test_a_model_that_explodes_is_refused_with_a_step_that_works(tmp_path: Path, cli, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stiff = ARM.replace(
        'timestep="0.005" integrator="implicitfast"', 'timestep="0.05" integrator="Euler"'
    )
    stiff = stiff.replace("<motor joint", '<position kp="100" joint').replace("-8 8", "-1 1")
    (tmp_path / "stiff.xml").write_text(stiff)
    result = cli("new", "stiff.xml", cwd=tmp_path)
    assert result.returncode == 3
    assert 'None did with <option timestep="' in result.stderr
    assert "MuJoCo warned" in result.stderr
    assert not list(tmp_path.glob("MUJOCO_LOG*"))


def test_actuators_without_a_range_are_guessed_wide_enough_and_named(tmp_path: Path):
    bare = ARM.replace(' ctrllimited="true" ctrlrange="-8 8"', "")
    system, proposal = written(tmp_path, bare)
    assert "control: the model gives no range for actuator_0;" in proposal.warnings[0]
    held = at(system.model, system.rest, np.zeros(2)).qfrc_bias[0]
    assert abs(held) < system.bounds.high[0]


def test_a_slide_that_nothing_keeps_near_is_named(tmp_path: Path):
    xml = (
        '<mujoco><worldbody><body><joint name="lift" type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body>'
        '</worldbody><actuator><motor joint="lift" ctrllimited="true" ctrlrange="-30 30"/></actuator></mujoco>'
    )
    _, proposal = written(tmp_path, xml)
    assert any("state.lift: neither a range nor a spring" in text for text in proposal.warnings)


def test_switched_off_actuators_are_refused(tmp_path: Path):
    off = ARM.replace('"implicitfast"/>', '"implicitfast"><flag actuation="disable"/></option>')
    (tmp_path / "off.xml").write_text(off)
    with pytest.raises(NeuroAnimatorError, match="switches all actuators off"):
        propose(tmp_path / "off.xml")


def test_actuators_whose_names_clash_are_refused(tmp_path: Path):
    clashing = ARM.replace('<motor joint="elbow"', '<motor name="actuator_0" joint="elbow"')
    (tmp_path / "clash.xml").write_text(clashing)
    with pytest.raises(NeuroAnimatorError, match="actuators: two parts are called 'actuator_0'"):
        propose(tmp_path / "clash.xml")


def test_how_long_the_data_will_take_is_said_before_they_are_made(tmp_path: Path, cli):
    (tmp_path / "arm.xml").write_text(ARM)
    result = cli("new", tmp_path / "arm.xml")
    assert "300,000 transitions take about" in result.stdout
    text = (tmp_path / "arm.toml").read_text()
    assert "300,000 transitions take about" in text
    assert 'keyframe = "out"' in text


def test_a_joint_that_is_flung_and_a_motor_that_does_nothing_are_named(tmp_path: Path):
    body = '<body name="b"><joint name="wild" axis="0 1 0" damping="-500"/><geom size="0.1" pos="0 0 1"/></body>'
    motor = '<motor name="m" joint="wild" gear="{}" ctrlrange="-1 1"/>'
    xml = f"<mujoco><worldbody>{body}</worldbody><actuator>{motor}</actuator></mujoco>"
    (tmp_path / "wild.xml").write_text(xml.format(1))
    with pytest.raises(NeuroAnimatorError, match="wild diverges first: use weaker actuators"):
        propose(tmp_path / "wild.xml")
    _, proposal = written(tmp_path, xml.format(0).replace('damping="-500"', ""))
    assert proposal.warnings[0].startswith("control: m move no joint.")
