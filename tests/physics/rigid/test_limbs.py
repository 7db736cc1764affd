"""Limbs named in the TOML file become networks of their own."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import Emulator, NeuroAnimatorError, TrainingConfig, load_system
from neuroanimator.emulator.networks.hierarchy import Hierarchy
from neuroanimator.emulator.networks.network import Part
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.physics.loading import resolve
from neuroanimator.scaffold.write_toml import write_definition

SWIMMER = """<mujoco><option timestep="0.005" integrator="RK4" gravity="0 0 0"/>
  <default><geom contype="0" conaffinity="0"/><joint damping="0.2" armature="0.05"/></default>
  <worldbody><body name="trunk"><freejoint name="root"/><geom type="box" size="0.2 0.1 0.05"/>
    <body name="chest" pos="0.2 0 0"><joint name="waist" axis="0 0 1" stiffness="2"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.05"/>
      <body name="left" pos="0.2 0.1 0"><joint name="left_shoulder" axis="0 0 1" limited="true" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0 0.3 0" size="0.03"/>
        <body name="left_arm" pos="0 0.3 0"><joint name="left_elbow" type="hinge" axis="1 0 0"/>
          <geom type="capsule" fromto="0 0 0 0 0.2 0" size="0.03"/></body></body>
      <body name="right" pos="0.2 -0.1 0"><joint name="right_shoulder" type="ball"/>
        <geom type="capsule" fromto="0 0 0 0 -0.3 0" size="0.03"/></body></body></body></worldbody>
  <tendon><fixed name="pull"><joint joint="left_shoulder" coef="1"/><joint joint="left_elbow" coef="-1"/></fixed>
  </tendon>
  <actuator><motor name="turn" joint="waist" gear="2" ctrlrange="-1 1"/>
    <motor name="twist" joint="right_shoulder" gear="1 0 0" ctrlrange="-1 1"/>
    <motor name="bend" joint="left_elbow" ctrlrange="-1 1"/>
    <motor name="draw" tendon="pull" ctrlrange="-1 1"/></actuator></mujoco>"""

ARMS = '\n[groups]\nleft = ["left_shoulder", "left_elbow"]\nright = ["right_shoulder"]\n'


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = tmp_path_factory.mktemp("swimmer") / "swimmer.xml"
    model.write_text(SWIMMER)
    path, _ = write_definition(str(model))
    path.write_text(path.read_text() + ARMS)
    return path


@pytest.fixture(scope="module")
def data(toml: Path) -> Transitions:
    name, definition, n = resolve(str(toml))
    return simulate_transitions(
        DatasetConfig(system=name, definition=definition, substeps=n, count=360, samples_per_run=36)
    )


def parts_of(data: Transitions) -> tuple[Emulator, tuple[Part, ...]]:
    emulator = build_emulator(data, TrainingConfig(network="hierarchy", widths=(16, 0, 8)))
    assert isinstance(emulator.network, Hierarchy)
    return emulator, emulator.network.parts


def test_a_group_has_the_places_and_rates_of_its_joints_and_the_motors_and_tendons_that_drive_them(
    toml: Path,
):
    system = load_system(str(toml))
    left, right = system.structure.groups
    names = system.state.names
    assert [names[i] for i in left.entries] == [
        "left_shoulder[0] rad", "left_elbow[0] rad", "left_shoulder.velocity[0] rad/s", "left_elbow.velocity[0] rad/s",
    ]  # fmt: skip
    assert {names[i].partition("[")[0] for i in right.entries} == {
        "right_shoulder.orientation",
        "right_shoulder.angular_velocity",
    }
    assert [system.control.names[i].partition("[")[0] for i in left.controls] == ["bend", "draw"]
    assert [system.control.names[i].partition("[")[0] for i in right.controls] == ["twist"]


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ("left = []", "groups.left: wanted one or more joints"),
        (
            'left = ["left_sholder"]',
            r"no joint called 'left_sholder'. Did you mean left_shoulder\? Joints: waist, left_shoulder",
        ),
        ('left = ["left_elbow", "left_elbow"]', "'left_elbow' is in 'left' already"),
        ('left = ["left_elbow"]\nright = ["left_elbow"]', "'left_elbow' is in 'left' already"),
        ('left = ["root", "left_elbow"]', "'root' is the root's"),
    ],
)
def test_groups_that_are_none_are_refused_by_name(groups: str, message: str, toml: Path):
    other = toml.with_name("other.toml")
    other.write_text(toml.read_text().replace(ARMS, f"\n[groups]\n{groups}\n"))
    with pytest.raises(NeuroAnimatorError, match=message):
        resolve(str(other))


def test_every_number_of_the_change_is_answered_once_and_the_root_and_waist_by_the_upper_network(
    data: Transitions,
):
    emulator, parts = parts_of(data)
    answered = [number for part in parts for number in part.answers]
    assert sorted(answered) == list(range(emulator.normaliser.unit.shape[0]))
    body, left, right = parts
    assert (
        len(body.answers) == 6 + 1 + 6 + 1
    )  # place and turn, waist; velocity and spin, waist's speed
    assert (len(left.answers), len(right.answers)) == (4, 6)
    assert left.hears == right.hears == body.answers


def test_a_child_sees_its_own_joints_and_motors_and_the_rest_but_no_other_limb(data: Transitions):
    """Whatever the right arm does, the left one's network is told only what the upper network makes of it."""
    emulator, (_, left, right) = parts_of(data)
    structure, controls = data.system.structure, data.system.control.size
    state, control = (
        np.asarray(data.states[0, 0], np.float32),
        np.asarray(data.controls[0, 0], np.float32),
    )

    def seen(part: Part, state: np.ndarray, control: np.ndarray) -> np.ndarray:
        stream, _ = emulator.features.streams(
            jnp.asarray(state), jnp.asarray(emulator.raw_features(state, control))
        )
        return np.asarray(stream)[list(part.odd)]

    def matters(part: Part, entry: int, *, is_control: bool = False) -> bool:
        moved = [state.copy(), control.copy()]
        moved[is_control][entry] += 0.1
        return bool(np.abs(seen(part, *moved) - seen(part, state, control)).max() > 1e-4)

    names = data.system.state.names
    waist, angular_velocity = (
        names.index("waist[0] rad"),
        names.index("root.angular_velocity[1] rad/s"),
    )
    for part, own, other in ((left, *structure.groups), (right, *structure.groups[::-1])):
        assert all(matters(part, entry) for entry in (own.entries[-1], waist, angular_velocity))
        # A ball's axes are among the few numbers every child sees; its spin is not.
        assert not any(
            matters(part, entry) for entry in other.entries if "orientation" not in names[entry]
        )
        for motor in range(controls):
            assert matters(part, motor, is_control=True) == (motor in own.controls)


def test_joints_that_are_all_in_groups_are_refused_where_no_root_is_left(tmp_path: Path):
    model = tmp_path / "arm.xml"
    fixed = SWIMMER.replace('<freejoint name="root"/>', "")
    model.write_text(fixed)
    path, _ = write_definition(str(model))
    path.write_text(path.read_text() + ARMS.replace("left =", 'waist = ["waist"]\nleft ='))
    name, definition, n = resolve(str(path))
    windows = simulate_transitions(
        DatasetConfig(system=name, definition=definition, substeps=n, count=72, samples_per_run=36)
    )
    with pytest.raises(NeuroAnimatorError, match="groups: every joint is in one"):
        parts_of(windows)


@pytest.mark.parametrize("kind", ["linear-glu", "hierarchy"])
def test_saving_and_loading_changes_no_bit(kind: str, data: Transitions, tmp_path: Path):
    emulator = build_emulator(data, TrainingConfig(network=kind))
    emulator.save(tmp_path / "a.safetensors")
    Emulator.load(tmp_path / "a.safetensors").save(tmp_path / "b.safetensors")
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()


@pytest.mark.endurance
def test_the_command_line_trains_a_hierarchy(toml: Path, cli, tmp_path: Path):
    out = tmp_path / "swimmer.emulator.safetensors"
    assert cli("generate", toml, "--count", 720, "--out", tmp_path / "data").returncode == 0
    wanted = (
        "train",
        tmp_path / "data",
        "--network",
        "hierarchy",
        "--updates",
        250,
        "--out",
        out,
    )
    result = cli(*wanted, "--widths", "16,0,8")
    assert result.returncode == 0, result.stderr
    network = Emulator.load(out).network
    assert isinstance(network, Hierarchy)
    assert network.widths == (16, 0, 8)
    wrong = cli(*wanted, "--widths", "16,8")
    assert "wanted the upper network's layers, 0, a child's layers; got [16, 8]" in wrong.stderr


def test_the_command_line_says_that_a_hierarchy_needs_groups(dataset: Path, cli, tmp_path: Path):
    result = cli(
        "train",
        dataset,
        "--network",
        "hierarchy",
        "--updates",
        250,
        "--out",
        tmp_path / "a.safetensors",
    )
    assert result.returncode != 0
    assert "pendulum has no [groups], which a hierarchy needs" in result.stderr
