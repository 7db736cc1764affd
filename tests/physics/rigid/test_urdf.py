"""A URDF moves: motors of its efforts, nothing that it does not say, a base that is fixed or free."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator import NeuroAnimatorError, load_system
from neuroanimator.errors import BadFileError
from neuroanimator.physics.loading import from_text
from neuroanimator.physics.rigid.compiled_model import compile_model
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.model_files import read_model_files


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


def test_efforts_are_motors_and_speed_limits_no_physics(tmp_path: Path):
    model = compiled(tmp_path, ROBOT)
    assert [model.actuator(i).name for i in range(model.nu)] == ["hip", "knee"]
    np.testing.assert_allclose(model.actuator_ctrlrange, [[-12, 12], [-5, 5]])
    # A limit is no damping; what the file says of damping stands.
    np.testing.assert_allclose(model.dof_damping, [0.0, 0.25])
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_HINGE


def test_a_joint_without_effort_swings(tmp_path: Path):
    model = compiled(tmp_path, ROBOT.replace('effort="5" ', ""))
    assert model.nu == 1


CART_POLE = (
    '<robot name="cartpole"><link name="rail"/>'
    + link("cart")
    + link("pole", 0.2).replace('"0 0 -0.2"', '"0 0 0.2"')
    + '<joint name="slider" type="prismatic"><parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/>'
    '<limit lower="-4" upper="4" effort="100" velocity="8"/></joint>'
    '<joint name="hinge" type="continuous"><parent link="cart"/><child link="pole"/><axis xyz="0 1 0"/>'
    '<limit effort="1000" velocity="5"/></joint></robot>'
)


def test_the_pole_of_a_cart_falls_freely_where_its_joint_is_passive(tmp_path: Path, cli):
    (tmp_path / "cart.urdf").write_text(CART_POLE)
    told = cli("new", tmp_path / "cart.urdf", "--passive", "hinge")
    assert "motors on slider, of <limit effort>" in told.stdout
    assert "a step of 0.002 s, if the file sets none" in told.stdout
    toml = tmp_path / "cart.toml"
    assert "# a motor of <limit effort>" in toml.read_text()
    system = from_text(load_system(str(toml)).definition_text)
    assert isinstance(system, ModelSystem)
    assert system.control.names == ["slider[0] N"]
    start = system.start_at({"hinge": [0.3]})
    [states] = system.simulate(start[None], np.zeros((1, 50, 1)), 0.02, scheme=system.fine).states
    assert states[:, 1].max() > np.pi
    np.testing.assert_allclose(energies(system, states), energies(system, states)[0], rtol=1e-4)


def energies(system: ModelSystem, states: np.ndarray) -> list[float]:
    """Return the kinetic and potential energy of each state [J]."""
    data = mujoco.MjData(system.model)
    totals = []
    for state in states:
        system.put(data, state)
        mujoco.mj_forward(system.model, data)
        mujoco.mj_energyPos(system.model, data)
        mujoco.mj_energyVel(system.model, data)
        totals.append(float(data.energy.sum()))
    return totals


def test_a_passive_joint_that_is_not_there_is_named(tmp_path: Path):
    (tmp_path / "cart.urdf").write_text(CART_POLE)
    with pytest.raises(NeuroAnimatorError, match="no joint called 'pole'. Joints: slider, hinge"):
        write_definition(str(tmp_path / "cart.urdf"), passive=("pole",))
    (tmp_path / "m.xml").write_text("<mujoco/>")
    with pytest.raises(NeuroAnimatorError, match="In an MJCF model take their actuators out"):
        write_definition(str(tmp_path / "m.xml"), passive=("pole",))


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
        compiled(tmp_path, ROBOT.replace("</robot>", world.format("revolute")), "free")


PUCK = """<robot name="puck">{before}<link name="{root}"/>
  <link name="puck"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="slide" type="{kind}"><parent link="{root}"/><child link="puck"/><axis xyz="0 0 1"/></joint></robot>"""

FIXED_BELOW = """<link name="base"/><joint name="fixed" type="fixed"><parent link="base"/><child link="{}"/></joint>"""


@pytest.mark.parametrize("kind", ["planar", "floating"])
@pytest.mark.parametrize("root", ["world", "ground", "fixed below"])
def test_what_moves_already_needs_no_free_base(tmp_path: Path, root: str, kind: str):
    before = FIXED_BELOW.format(root) if root == "fixed below" else ""
    path = tmp_path / "puck.urdf"
    path.write_text(PUCK.format(root=root, kind=kind, before=before))
    files = read_model_files(path)
    message = f"moves already by the {kind} joint 'slide'. Use base = fixed."
    with pytest.raises(BadFileError, match=message):
        compile_model(files, "free")
    assert compile_model(files, "fixed").nv == {"planar": 3, "floating": 6}[kind]


def test_a_root_without_mass_is_free_as_the_message_says(tmp_path: Path):
    path = tmp_path / "puck.urdf"
    text = PUCK.format(root="ground", kind="continuous", before="")
    path.write_text(text)
    with pytest.raises(BadFileError) as caught:
        compile_model(read_model_files(path), "free")
    told = re.search(
        "or add (<compiler .*?/>) \\(in a URDF inside of <mujoco>\\)", str(caught.value)
    )
    assert told is not None
    path.write_text(text.replace("<link", f"<mujoco>{told[1]}</mujoco><link", 1))
    assert compile_model(read_model_files(path), "free").nv == 7


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
    with pytest.raises(NeuroAnimatorError, match="mimics the joint 'hipp', which does not exist"):
        compiled(tmp_path, text.replace('mimic joint="hip"', 'mimic joint="hipp"'))


@pytest.mark.parametrize("number", ["nan", "inf"])
def test_an_effort_that_is_no_number_is_refused(tmp_path: Path, number: str):
    with pytest.raises(NeuroAnimatorError, match="<limit effort>: wanted a finite number"):
        compiled(tmp_path, ROBOT.replace('effort="12"', f'effort="{number}"'))


@pytest.mark.parametrize("base", ["fixed", pytest.param("free", marks=pytest.mark.endurance)])
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
