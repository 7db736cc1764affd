"""A URDF moves: motors of its efforts, damping of its speed limits, a base that is fixed or free."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator import NeuroAnimatorError, load_system
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.rigid.model_files import compile_model, read_model_files


def link(name: str, mass: float = 1.0) -> str:
    shape = '<geometry><box size="0.1 0.1 0.4"/></geometry>'
    inertia = '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>'
    place = '<origin xyz="0 0 -0.2"/>'
    return (
        f'<link name="{name}"><inertial>{place}<mass value="{mass}"/>{inertia}</inertial>'
        f"<collision>{place}{shape}</collision></link>"
    )


def joint(name: str, parent: str, child: str, inside: str) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 -0.5"/><axis xyz="0 1 0"/>{inside}</joint>'
    )


ROBOT = (
    '<robot name="r">'
    + link("base", 4)
    + link("upper")
    + link("lower")
    + joint("hip", "base", "upper", '<limit lower="-1" upper="2" effort="12" velocity="6"/>')
    + joint(
        "knee",
        "upper",
        "lower",
        '<limit lower="-1" upper="1" effort="5" velocity="9"/><dynamics damping="0.25"/>',
    )
    + '<gazebo><plugin filename="libx.so"/></gazebo></robot>'
)


def compiled(folder: Path, text: str, base="fixed") -> mujoco.MjModel:
    (folder / "r.urdf").write_text(text)
    return compile_model(read_model_files(folder / "r.urdf"), base)


def test_efforts_are_motors_and_speed_limits_damping(tmp_path: Path):
    model = compiled(tmp_path, ROBOT)
    assert [model.actuator(i).name for i in range(model.nu)] == ["hip", "knee"]
    np.testing.assert_allclose(model.actuator_ctrlrange, [[-12, 12], [-5, 5]])
    # 12 N·m at most make 6 rad/s at most; what the file says of damping stands.
    np.testing.assert_allclose(model.dof_damping, [2.0, 0.25])
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_HINGE


def test_a_joint_without_effort_swings(tmp_path: Path):
    model = compiled(tmp_path, ROBOT.replace('effort="5" ', ""))
    assert model.nu == 1


def test_a_free_base_stands_on_a_floor(tmp_path: Path):
    model = compiled(tmp_path, ROBOT, "free")
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert all(abs(contact.dist) < 1e-6 for contact in data.contact)
    assert data.xpos[1][2] == pytest.approx(1.4)  # three links of 0.4 m, 0.1 m apart
    assert model.body_subtreemass[1] == pytest.approx(6.0)


def test_a_base_that_is_joined_to_the_world_cannot_be_free(tmp_path: Path):
    world = '<link name="world"/><joint name="weld" type="{}"><parent link="world"/><child link="base"/></joint></robot>'
    for kind in ("fixed", "floating"):
        model = compiled(tmp_path, ROBOT.replace("</robot>", world.format(kind)), "fixed")
        assert model.nu == 2
    with pytest.raises(NeuroAnimatorError, match="no root link that could be free"):
        compiled(tmp_path, ROBOT.replace("</robot>", world.format("floating")), "free")


def test_a_mimicking_joint_follows_and_has_no_motor(tmp_path: Path):
    text = ROBOT.replace(
        '<dynamics damping="0.25"/>', '<mimic joint="hip" multiplier="-0.5" offset="0.1"/>'
    )
    model = compiled(tmp_path, text)
    assert model.nu == 1
    data = mujoco.MjData(model)
    data.ctrl[0] = 6.0
    mujoco.mj_step(model, data, 2000)
    assert data.qpos[1] == pytest.approx(0.1 - 0.5 * data.qpos[0], abs=0.02)
    with pytest.raises(NeuroAnimatorError, match="mimics the joint 'hipp', which is not there"):
        compiled(tmp_path, text.replace('mimic joint="hip"', 'mimic joint="hipp"'))


@pytest.mark.parametrize("number", ["nan", "inf"])
def test_an_effort_that_is_no_number_is_refused(tmp_path: Path, number: str):
    with pytest.raises(NeuroAnimatorError, match="<limit effort>: wanted a finite number"):
        compiled(tmp_path, ROBOT.replace('effort="12"', f'effort="{number}"'))


@pytest.mark.parametrize("base", ["fixed", "free"])
def test_a_urdf_is_proposed_and_made_again_from_its_definition(tmp_path: Path, base):
    (tmp_path / "r.urdf").write_text(ROBOT)
    path, proposal = write_definition(str(tmp_path / "r.urdf"), base=base)
    # What just touches the floor at rest is not thrown off by it.
    assert proposal.definition.substeps * proposal.definition.physics.step >= 0.02
    system = load_system(str(path))
    assert system.control.names == ["hip[0] N·m", "knee[0] N·m"]
    assert system.state.size == {"fixed": 4, "free": 17}[base]


def test_a_urdf_that_nothing_drives_is_refused_with_the_fix(tmp_path: Path):
    (tmp_path / "r.urdf").write_text(ROBOT.replace("effort", "force"))
    with pytest.raises(NeuroAnimatorError, match="Motors are made of <limit effort"):
        write_definition(str(tmp_path / "r.urdf"))
