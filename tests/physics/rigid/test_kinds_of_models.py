"""Every kind of joint, actuator and constraint of MuJoCo's is emulated as it is, or refused by name."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator import DatasetConfig, NeuroAnimatorError, load_system
from neuroanimator.definitions.model import Definition
from neuroanimator.learn.data.shard import make_shard
from neuroanimator.physics import carried_system
from neuroanimator.physics.loading import resolve
from neuroanimator.physics.rigid.compiled_model import compile_model
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.scaffold.model import proposed_feature
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.model_files import read_model_files

TIME = 0.02
"""The physics is compared over this time [s]."""

LINK = """<body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="0.1"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.4" contype="0" conaffinity="0"/>
  <site name="mid" pos="0.2 0 0.05"/>
  <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" damping="0.1"/><site name="tip" pos="0.3 0 0"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.3" contype="0" conaffinity="0"/></body></body>"""

MOTOR = '<motor name="m" joint="shoulder" ctrlrange="-1 1" ctrllimited="true"/>'

FLOOR = '<geom type="plane" size="5 5 1"/>'

BALL = '<body name="{0}" pos="{1} 0 0.1"><freejoint name="{0}"/><geom size="0.1" mass="0.3"/><site name="{0}"/></body>'


def model_with(
    bodies: str = LINK, actuators: str = MOTOR, others: str = "", option: str = ""
) -> str:
    return (
        f'<mujoco><option timestep="0.005" integrator="implicitfast" {option}/><worldbody>{bodies}</worldbody>'
        f"{others}<actuator>{actuators}</actuator></mujoco>"
    )


def on_shoulder(tag: str, more: str) -> str:
    return f'<{tag} name="m" joint="shoulder" {more}/>'


def tendon(inside: str) -> str:
    return f"<tendon>{inside}</tendon>"


FIXED_TENDON = (
    '<fixed name="t"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="-0.5"/></fixed>'
)
SPATIAL_TENDON = (
    '<spatial name="t" stiffness="20" springlength="0.2">'
    '<site site="post"/><site site="mid"/><site site="tip"/></spatial>'
)
PULL = '<motor name="m" tendon="t" ctrlrange="-3 0" ctrllimited="true"/>'
ROPE = '<tendon><spatial name="t" limited="true" range="0 0.5"><site site="a"/><site site="b"/></spatial></tendon>'
PUSH = '<motor name="m" site="a" gear="1 0 0 0 0 0" ctrlrange="-1 1" ctrllimited="true"/>'

ON_BALL = """<body pos="0 0 1"><joint name="shoulder" type="ball" damping="0.1"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/></body>"""

KINDS = {
    "position servo": model_with(actuators=on_shoulder("position", 'kp="20" ctrlrange="-1 1"')),
    "velocity servo": model_with(actuators=on_shoulder("velocity", 'kv="2" ctrlrange="-3 3"')),
    "servo of velocities": model_with(
        actuators=on_shoulder("intvelocity", 'kp="20" actrange="-1 1" ctrlrange="-2 2"')
    ),
    "muscle": model_with(actuators=on_shoulder("muscle", 'force="5" lengthrange="-1 1"')),
    "damper": model_with(
        actuators=MOTOR + '<damper name="d" joint="elbow" kv="2" ctrlrange="0 1"/>'
    ),
    "cylinder": model_with(
        actuators=on_shoulder("cylinder", 'timeconst="0.1" area="0.01" ctrlrange="-99 99"')
    ),
    "filtered motor": model_with(
        actuators=on_shoulder("general", 'dyntype="filter" dynprm="0.05" ctrlrange="-1 1"')
    ),
    "PID servo": model_with(
        actuators=on_shoulder(
            "pid",
            'kp="20" kv="1" ki="2" imax="1" input="pos vel ff" posrange="-1 1" velrange="-2 2" ffrange="-1 1"',
        )
    ),
    "DC motor with a controller": model_with(
        actuators=on_shoulder(
            "dcmotor",
            'motorconst="0.05" resistance="1" controller="4 0 0.1" input="pos voltage" ctrlrange="-1 1"',
        )
    ),
    "DC motor without inputs": model_with(
        actuators='<dcmotor name="brake" joint="elbow" motorconst="0.05" resistance="1" input="none"/>'
        + MOTOR
    ),
    "orientation by a quaternion": model_with(
        ON_BALL,
        '<orientation name="o" joint="shoulder" input="quat" kp="2" kv="0.1" ctrlrange="-1 1"/>',
    ),
    "orientation by a rotation vector": model_with(
        ON_BALL, '<orientation name="o" joint="shoulder" kp="2" kv="0.1" ctrlrange="-1 1"/>'
    ),
    "fixed tendon": model_with(actuators=PULL, others=tendon(FIXED_TENDON)),
    "spatial tendon": model_with(
        LINK + '<site name="post" pos="0 0 1.3"/>', PULL, tendon(SPATIAL_TENDON)
    ),
    "tied joints": model_with(
        others='<equality><joint joint1="elbow" joint2="shoulder" polycoef="0 -1 0 0 0"/></equality>'
    ),
    "closed chain": model_with(
        others='<equality><connect body1="lower" body2="world" anchor="0.3 0 0"/></equality>'
    ),
    "mocap": model_with(
        LINK
        + '<body name="hand" mocap="true" pos="0.9 0 1"><geom size="0.02" contype="0" conaffinity="0"/></body>',
        others='<equality><weld body1="hand" body2="lower" solref="0.1 1"/></equality>',
    ),
    "sensors": model_with(others='<sensor><touch name="s" site="tip"/><gyro site="tip"/></sensor>'),
    "ball joint": model_with(
        ON_BALL,
        '<motor name="m" joint="shoulder" gear="0 1 0" ctrlrange="-0.5 0.5"/>',
    ),
    "two free bodies": model_with(FLOOR + BALL.format("a", 0) + BALL.format("b", 0.4), PUSH, ROPE),
    "an arm and a ball": model_with(FLOOR + LINK + BALL.format("b", 0.3)),
    "force along the world": model_with(
        FLOOR + BALL.format("a", 0),
        '<motor name="m" joint="a" gear="1 0 0 0 0 0" ctrlrange="-1 1"/>',
    ),
    "suction": model_with(
        FLOOR + BALL.format("a", 0),
        '<adhesion name="m" body="a" gain="5" ctrlrange="0 1"/>' + PUSH.replace('"m"', '"n"'),
    ),
    "skin": model_with(
        others='<deformable><skin name="s" vertex="0 0 0 1 0 0 0 1 0" face="0 1 2"><bone body="upper" bindpos="0 0 0" '
        'bindquat="1 0 0 0" vertid="0 1 2" vertweight="1 1 1"/></skin></deformable>'
    ),
}


TOML = """name = "model"
model = "model.xml"
substeps = 10
[physics]
step = 0.005
truth_step = 0.0025
fine_step = 0.0005
"""


def system_of(folder: Path, xml: str) -> tuple[ModelSystem, DatasetConfig]:
    """Return the system of a model by a definition that leaves everything else to it."""
    (folder / "model.xml").write_text(xml)
    (folder / "model.toml").write_text(TOML)
    name, definition, substeps = resolve(str(folder / "model.toml"))
    config = DatasetConfig(system=name, definition=definition, substeps=substeps, count=120)
    system = carried_system(name, definition)
    assert isinstance(system, ModelSystem)
    return system, config


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_simulated_as_mujoco_does_and_makes_data(kind: str, tmp_path: Path):
    system, config = system_of(tmp_path, KINDS[kind])
    shard = make_shard(system, config, 0, threads=1)
    assert shard.diverged <= 1
    states = shard.tensors["states"].astype(float)
    assert np.isfinite(states).all()
    moved = np.abs(np.diff(states, axis=1)).max(axis=(0, 1))
    assert moved.max() > 1e-3
    own = mujoco.MjModel.from_xml_string(KINDS[kind])
    for count in ("nbody", "njnt", "neq", "ntendon", "nu", "nsensor"):
        assert getattr(system.model, count) == getattr(own, count)
    own.opt.timestep = system.truth.dt
    own.opt.integrator = system.model_with(system.truth).opt.integrator
    data = mujoco.MjData(own)
    rest = system.rest[: system.physical_size]
    mujoco.mj_setState(own, data, rest, mujoco.mjtState.mjSTATE_PHYSICS)
    data.ctrl[:] = system.bounds.high
    steps = round(TIME / own.opt.timestep)
    mujoco.mj_step(own, data, steps)
    expected = np.empty(system.physical_size)
    mujoco.mj_getState(own, data, expected, mujoco.mjtState.mjSTATE_PHYSICS)
    controls = np.array(system.bounds.high)[None, None]
    after = system.simulate(system.rest[None], controls, steps * own.opt.timestep).states[0, 1]
    np.testing.assert_allclose(after[: system.physical_size], expected, atol=1e-9)


@pytest.mark.parametrize("kind", ["two free bodies", "an arm and a ball"])
def test_a_network_sees_where_each_of_several_bodies_stands(kind: str, tmp_path: Path):
    system, _ = system_of(tmp_path, KINDS[kind])
    frame = Frame.of(system.structure, 0.05)
    state = system.rest.copy()
    for entry, _ in system.structure.orientations:
        state[entry : entry + 4] = [0.5, 0.5, -0.5, 0.5]
    angles = {entry for row in system.structure.angles for entry in np.flatnonzero(row)}
    for entry in range(system.physical_size):
        other = state.copy()
        other[entry] += 0.1
        is_local = not np.allclose(frame.local(other), frame.local(state))
        assert is_local or entry in angles or entry in system.structure.plain


def test_new_lets_the_place_of_several_bodies_matter_and_that_of_one_alone_not(tmp_path: Path):
    one = model_with(FLOOR + BALL.format("a", 0), PUSH)
    pushed = '<motor name="m" joint="a" gear="1 0 0 0 0 0" ctrlrange="-1 1"/>'
    models = {
        "free": one,
        "placed": KINDS["two free bodies"],
        "pushed": model_with(FLOOR + BALL.format("a", 0), pushed),
    }
    features = {}
    for name, xml in models.items():
        (tmp_path / f"{name}.xml").write_text(xml)
        model = compile_model(read_model_files(tmp_path / f"{name}.xml"))
        features[name] = proposed_feature(model, 0, ())
    assert features == {"free": "free", "placed": "placed", "pushed": "placed"}


def test_new_spreads_several_bodies_over_the_floor_they_lie_on(tmp_path: Path):
    (tmp_path / "model.xml").write_text(KINDS["two free bodies"])
    path, proposal = write_definition(str(tmp_path / "model.xml"))
    definition = proposal.definition
    assert isinstance(definition, Definition)
    assert definition.state == {"a": "placed", "b": "placed"}
    assert not proposal.warnings
    starts = load_system(str(path)).sample_starts(np.random.default_rng(0), 200)
    heights = starts[:, [2, 9]]
    assert heights.min() > 0.05
    assert np.ptp(starts[:, 7]) > 0.05


REFUSED = {
    "composites are not supported. Write a rope": model_with(
        others='<worldbody><body><composite type="cable"/></body></worldbody>'
    ),
    "plugins run foreign code": model_with(
        others='<extension><plugin plugin="mujoco.pid"/></extension>'
    ),
    "is not part of the state. Remove nsample and delay": model_with(
        actuators=on_shoulder("motor", 'ctrlrange="-1 1" delay="0.02" nsample="5"')
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_not_emulated_is_refused_with_what_to_do(message: str, tmp_path: Path):
    (tmp_path / "model.xml").write_text(REFUSED[message])
    with pytest.raises(NeuroAnimatorError) as caught:
        write_definition(str(tmp_path / "model.xml"))
    assert message in str(caught.value)


def test_new_says_that_a_mocap_body_stays_where_it_is(tmp_path: Path):
    (tmp_path / "model.xml").write_text(KINDS["mocap"])
    _, proposal = write_definition(str(tmp_path / "model.xml"))
    assert any(warning.startswith("mocap: hand stays") for warning in proposal.warnings)
