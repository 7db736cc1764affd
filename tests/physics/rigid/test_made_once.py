"""What MuJoCo makes of a file itself is not made a second time: held against MuJoCo's own reading, at every release of it."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import mujoco
import pytest
from closed_chains import MODELS, model_of

from neuroanimator.physics.rigid.compiled_model import ModelRequest, compile_here
from neuroanimator.systems.model_files import read_model_files

COUNTS = ("nbody", "njnt", "nv", "ngeom", "neq", "ntendon", "nsensor", "nu", "na", "npair")
"""MuJoCo's counts of what a model is made of."""

LINK = (
    '<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
)

JOINT = (
    '<joint name="{0}" type="{1}"><parent link="base"/><child link="{0}_link"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" effort="{2}" velocity="1"/>{3}</joint>'
)

TRANSMISSION = (
    '<transmission name="t_{0}"><type>transmission_interface/SimpleTransmission</type><joint name="{0}">'
    "<hardwareInterface>EffortJointInterface</hardwareInterface></joint>"
    '<actuator name="m_{0}"><mechanicalReduction>50</mechanicalReduction></actuator></transmission>'
)

LEADER = ("leader", "revolute", 3, "")
PASSIVE = ("swing", "continuous", 0, "")
SLIDING = ("slide", "prismatic", 5, "")


def following(name: str, leader: str, numbers: str = "", kind: str = "revolute") -> tuple:
    return (name, kind, 3, f'<mimic joint="{leader}" {numbers}/>')


URDFS = {
    "efforts": (LEADER, PASSIVE, SLIDING),
    "mimic": (LEADER, following("follower", "leader", 'multiplier="-0.5" offset="0.1"')),
    "mimic of its own numbers": (LEADER, following("follower", "leader")),
    "leader after its follower": (following("follower", "leader"), LEADER),
    "chain of mimics": (LEADER, following("a", "leader"), following("b", "a", 'offset="0.2"')),
    "two fingers": (
        SLIDING,
        following("finger", "slide", 'multiplier="-1"', "prismatic"),
        following("thumb", "slide", 'multiplier="2"', "revolute"),
    ),
    "mimic of a joint that turns for ever": (PASSIVE, following("follower", "swing")),
}
"""Joints of robots: (name, type, effort, what is inside)."""


def urdf_of(joints: tuple, transmissions: bool = False) -> str:
    links = "".join(LINK.format(f"{joint[0]}_link") for joint in joints)
    inside = "".join(JOINT.format(*joint) for joint in joints)
    drives = ""
    if transmissions:
        drives = "".join(TRANSMISSION.format(joint[0]) for joint in joints)
    return f'<robot name="r">{LINK.format("base")}{links}{inside}{drives}</robot>'


def ours(path: Path, passive: tuple[str, ...] = ()) -> dict[str, int]:
    files = read_model_files(path)
    content = compile_here(ModelRequest(files.main, files.documents(), "fixed", passive))
    return counts(mujoco.MjModel.from_binary_path("m.mjb", {"m.mjb": content}))


def counts(model: mujoco.MjModel) -> dict[str, int]:
    return {name: getattr(model, name) for name in COUNTS}


@pytest.mark.parametrize("transmissions", [False, True])
@pytest.mark.parametrize("kind", URDFS)
def test_a_urdf_gets_motors_and_nothing_else_beyond_what_mujoco_reads(
    tmp_path: Path, kind: str, transmissions: bool
):
    path = tmp_path / "r.urdf"
    path.write_text(urdf_of(URDFS[kind], transmissions))
    own = counts(mujoco.MjModel.from_xml_path(str(path)))
    motors = [name for name, _, effort, inside in URDFS[kind] if effort and not inside]
    # MuJoCo reads neither efforts nor transmissions; once it does, ours would be the second motors.
    assert own["nu"] == own["ntendon"] == 0
    assert own["neq"] == sum("mimic" in inside for *_, inside in URDFS[kind])
    assert ours(path) == own | {"nu": len(motors)}
    assert ours(path, tuple(motors)) == own


@pytest.mark.parametrize("kind", MODELS)
def test_an_mjcf_model_is_what_mujoco_reads(tmp_path: Path, kind: str):
    path = tmp_path / "m.xml"
    path.write_text(model_of(MODELS[kind]))
    assert ours(path) == counts(mujoco.MjModel.from_xml_path(str(path)))


@pytest.mark.parametrize("name", ["arm", "lander", "truck", "pendulum"])
def test_a_model_that_ships_is_what_mujoco_reads(name: str):
    with resources.as_file(resources.files("neuroanimator.systems") / "assets") as folder:
        path = folder / f"{name}.xml"
        assert ours(path) == counts(mujoco.MjModel.from_xml_path(str(path)))
