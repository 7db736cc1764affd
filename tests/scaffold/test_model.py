"""Anybody's own MJCF becomes an emulator without a line of Python."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import Cli
from small_trainings import small_training

from neuroanimator import (
    DatasetConfig,
    Emulator,
    NeuroAnimatorError,
    evaluate,
    generate,
    load_system,
)
from neuroanimator.definitions.carried import data_identity
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.store import read_transitions
from neuroanimator.learn.evaluation.evaluate import EvaluationBudget
from neuroanimator.physics.loading import resolve
from neuroanimator.scaffold.defaults import usual_name
from neuroanimator.scaffold.model import Proposal, propose, proposed_feature
from neuroanimator.scaffold.write_toml import write_definition

CART = """<mujoco model="cart">
  <option timestep="0.01" integrator="RK4"/>
  <worldbody>
    <body name="cart">
      <joint name="track" type="slide" axis="1 0 0" damping="0.5"/>
      <geom type="box" size="0.2 0.1 0.1" mass="1" contype="0" conaffinity="0"/>
      <body name="pole">
        <joint name="hinge" type="hinge" axis="0 1 0" damping="0.02"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.6" size="0.04" mass="0.3" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="track" ctrlrange="-5 5" ctrllimited="true"/></actuator>
</mujoco>"""

BALL = """<mujoco><worldbody><geom type="plane" size="5 5 1"/>
  <body name="post"><joint name="neck" type="ball" damping="0.1"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.05" contype="0" conaffinity="0"/></body>
  </worldbody><actuator><motor name="twist" joint="neck" gear="0 0 1" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.fixture
def cart(tmp_path: Path) -> Path:
    path = tmp_path / "cart.xml"
    path.write_text(CART)
    return path


@pytest.fixture(scope="module")
def cart_proposal(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Proposal]:
    """The TOML text that 'new' writes for the cart, and the proposal: it tries the model out for half a second."""
    path = tmp_path_factory.mktemp("cart") / "cart.xml"
    path.write_text(CART)
    toml, proposal = write_definition(str(path))
    return toml.read_text(), proposal


@pytest.fixture
def proposed(cart_proposal: tuple[str, Proposal]) -> str:
    return cart_proposal[0]


@pytest.fixture
def toml(cart: Path, proposed: str) -> Path:
    """The cart's TOML file, as it was proposed, beside the model."""
    path = cart.with_suffix(".toml")
    path.write_text(proposed)
    return path


def test_what_joints_are_decides_how_they_are_seen(cart_proposal: tuple[str, Proposal]):
    found = cart_proposal[1].definition
    assert found.state == {"track": "cyclic", "hinge": "sine"}
    assert found.control == {"push": (-5.0, 5.0)}
    assert 1 < found.substeps <= 10
    assert found.physics.integrator == "rk4"
    assert proposed_feature(mujoco.MjModel.from_xml_string(BALL), 0, ()) == "ball"


def test_joints_and_actuators_without_names_get_numbers(cart: Path):
    bare = CART.replace(' name="hinge"', "").replace('<motor name="push"', "<motor")
    cart.write_text(
        bare.replace(
            "</body>",
            '<body pos="0 0 -0.6"><joint type="hinge" axis="0 1 0"/><geom size="0.1"/></body></body>',
            1,
        )
    )
    path, proposal = write_definition(str(cart))
    found = proposal.definition
    assert found.state == {"track": "cyclic", "joint_1": "sine", "joint_2": "sine"}
    assert found.control == {"actuator_0": (-5.0, 5.0)}
    assert load_system(str(path)).structure.angles == (
        (0, 1, 0, 0, 0, 0),
        (0, 0, 1, 0, 0, 0),
        (0, 1, 1, 0, 0, 0),
    )


def test_gymnasiums_models_are_proposed_with_their_symmetries(tmp_path: Path):
    path, proposal = write_definition("Swimmer-v5", tmp_path / "model.toml")
    assert path.exists()
    assert proposal.definition.frame.planar == ("slider1", "slider2", "free_body_rot")
    reference, definition, _ = resolve(str(path))
    system = load_system(reference, definition)
    starts = system.sample_starts(np.random.default_rng(0), 4)
    runs = system.simulate(starts, np.zeros((4, 5, system.control.size)), 0.2)
    assert not runs.has_diverged.any()


def test_files_are_named_after_what_was_typed(cart: Path, cli: Cli, tmp_path: Path):
    told = cli("new", "Swimmer-v5", cwd=tmp_path)
    assert (tmp_path / "Swimmer-v5.toml").exists()
    assert "system      swimmer-v5\n" in told.stdout
    assert "train Swimmer-v5.toml --out Swimmer-v5.emulator.safetensors" in told.stdout
    named = cart.with_name("My Cart.xml")
    named.write_text(cart.read_text())
    told = cli("new", named.name, cwd=cart.parent)
    assert "--out 'My Cart.emulator.safetensors'" in told.stdout
    assert (cart.parent / "My Cart.toml").exists()


@pytest.mark.endurance
def test_the_command_line_goes_all_the_way(cart: Path, cli, tmp_path: Path):
    goal = (
        '\n[goals.right]\nseconds = 1.0\nreach = { "track" = [0.5] }\nwithin = { "track" = 0.05 }\n'
    )
    assert cli("new", cart).returncode == 0
    toml, out = cart.with_suffix(".toml"), tmp_path / "cart.emulator.safetensors"
    toml.write_text(toml.read_text() + goal)
    for arguments in (
        ("generate", toml, "--count", 3000, "--out", tmp_path / "data"),
        (
            "train",
            tmp_path / "data",
            *small_training(1000, "24,24", 256),
            "--out",
            out,
        ),
        ("animate", out, "--seconds", 1, "--out", tmp_path / "clip.glb"),
        (
            "control",
            out,
            "--goal",
            "right",
            "--data",
            tmp_path / "data",
            "--out",
            tmp_path / "c.csv",
        ),
        ("info", out),
    ):
        result = cli(*arguments)
        assert result.returncode == 0, result.stderr
    toml.unlink(), cart.unlink()  # the emulator carries its system along
    found = evaluate(
        Emulator.load(out),
        budget=EvaluationBudget(runs=4, transitions=100, repeats=1, starts=20, steps=100),
    )
    assert found.one_step_error < 0.1
    assert found.diverged == 0
    assert found.speed.nominal > 1


def test_sensors_are_emulated_and_agree_with_mujoco(cart: Path):
    cart.write_text(
        CART.replace("</mujoco>", '<sensor><jointvel name="pace" joint="track"/></sensor></mujoco>')
    )
    path, _ = write_definition(str(cart))
    assert "of: pace" in path.read_text()
    path.write_text(path.read_text().replace("sensors = []", 'sensors = ["pace"]'))
    system = load_system(str(path))
    assert system.state.names[-1] == "sensor.pace[0] 1"
    starts = system.sample_starts(np.random.default_rng(0), 5)
    np.testing.assert_allclose(starts[:, 4], starts[:, 2])
    fine = system.simulate(starts, np.ones((5, 3, 1)), 0.1, scheme=system.fine)
    np.testing.assert_allclose(
        fine.states[:, :, 4], fine.states[:, :, 2], atol=0.02
    )  # of the step before
    path.write_text(path.read_text().replace('"pace"', '"race"'))
    with pytest.raises(
        NeuroAnimatorError, match=r"no sensor called 'race'. Did you mean pace\? Sensors: pace"
    ):
        load_system(str(path))


def test_a_toml_file_holds_edits_and_is_not_overwritten(cart: Path, toml: Path):
    path = toml
    path.write_text(path.read_text() + "# mine\n")
    with pytest.raises(NeuroAnimatorError, match="--force overwrites it"):
        write_definition(str(cart))
    assert path.read_text().endswith("# mine\n")
    write_definition(str(cart), force=True)
    assert not path.read_text().endswith("# mine\n")


def test_the_toml_says_all_of_the_definition_and_nothing_else(cart_proposal: tuple[str, Proposal]):
    text, proposal = cart_proposal
    written = tomllib.loads(text)
    assert written == json.loads(
        proposal.definition.model_dump_json(
            exclude={
                "goals",
                "groups",
                "tree",
                "holding",
                "passive",
                "parameters",
                "task",
                "follow",
            }
        )
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda xml: xml.replace("<motor", "<!--").replace('limited="true"/>', "-->"), "no actuators"),
        (lambda xml: xml.replace('"hinge" type', '"track.velocity" type'), "two parts are called 'track.velocity'"),
        (lambda xml: xml.replace('timestep="0.01"', 'timestep="-1"'), "timestep"),
        (lambda xml: xml.replace("<body name=\"cart\">", '<include file="../x.xml"/><body name="cart">'), r"\.\."),
        (lambda xml: xml.replace("</worldbody>", '<flexcomp name="x" type="grid" count="3 3 1"/></worldbody>'), "mocap bodies"),
    ],
)  # fmt: skip
def test_models_that_cannot_be_emulated_are_refused_by_name(change, message: str, cart: Path):
    cart.write_text(change(CART))
    with pytest.raises(NeuroAnimatorError, match=message):
        propose(cart)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda toml: toml.replace("[physics]\n", "[physics]\nstpe = 1\n"), "physics.stpe"),
        (
            lambda toml: toml.replace('hinge = "sine"', 'hinge = "ball"'),
            "state.hinge: a hinge joint cannot be 'ball'",
        ),
        (
            lambda toml: toml.replace('hinge = "sine"', 'hinge = "placed"'),
            "state.hinge: a hinge joint cannot be 'placed'. Features: sine",
        ),
        (
            lambda toml: toml.replace('hinge = "sine"', 'hinjge = "sine"'),
            r"No joint called 'hinjge'. Did you mean hinge\? Joints: track",
        ),
        (lambda toml: toml.replace("push = [-5.0, 5.0]", "push = [5.0, -5.0]"), "control.push"),
        (
            lambda toml: toml.replace("push =", "pull ="),
            "no actuator called 'pull'. Actuators: push",
        ),
        (
            lambda toml: toml.replace('model = "cart.xml"', 'model = "../cart.xml"'),
            "wanted a file in the folder of this one, or an absolute path",
        ),
        (
            lambda toml: toml.replace('model = "cart.xml"', 'model = "cart.xml"\ntree = ".."'),
            "tree: value error, wanted a file in the folder of this one",
        ),
        (
            lambda toml: toml + '\n[goals.x]\nreach = { "trakc" = [1.0] }\n',
            "No part called 'trakc'",
        ),
    ],
)
def test_a_wrong_line_in_the_toml_is_named(change, message: str, toml: Path):
    toml.write_text(change(toml.read_text()))
    with pytest.raises(NeuroAnimatorError, match=message):
        resolve(str(toml))


def test_the_toml_may_lie_anywhere_and_says_where_the_model_is(
    cart: Path, toml: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    beside = toml
    elsewhere, _ = write_definition(str(cart), tmp_path / "other" / "cart.toml")
    (tmp_path / "deep").mkdir()
    inside = cart.rename(tmp_path / "deep" / "cart.xml")
    above, _ = write_definition(str(inside), tmp_path / "above.toml", name="cart")
    inside.rename(cart)
    assert tomllib.loads(elsewhere.read_text())["model"] == str(cart)
    assert tomllib.loads(above.read_text())["model"] == "deep/cart.xml"
    monkeypatch.chdir(tmp_path / "deep")
    assert resolve(str(elsewhere)) == resolve(str(beside))
    assert str(tmp_path) not in resolve(str(elsewhere))[1]


def test_a_tree_is_written_down_as_its_model_is(tmp_path: Path):
    (tmp_path / "robots" / "arm").mkdir(parents=True)
    model = tmp_path / "robots" / "arm" / "cart.xml"
    model.write_text('<mujoco><include file="../cart.xml"/></mujoco>')
    tree = tmp_path / "robots"
    (tree / "cart.xml").write_text(CART)
    with pytest.raises(NeuroAnimatorError, match=f"use 'new --tree {tree}'"):
        write_definition(str(model))
    within, _ = write_definition(str(model), tree / "cart.toml", tree=tree)
    elsewhere, _ = write_definition(str(model), tmp_path / "other.toml", tree=tree, name="cart")
    assert tomllib.loads(within.read_text())["tree"] == "."
    assert tomllib.loads(elsewhere.read_text())["tree"] == "robots"
    assert data_identity(resolve(str(within))[1]) == data_identity(resolve(str(elsewhere))[1])


def test_a_dataset_carries_its_system_and_another_edit_is_another_dataset(
    toml: Path, tmp_path: Path
):
    name, definition, n = resolve(str(toml))
    generate(
        DatasetConfig(system=name, definition=definition, substeps=n, count=120), tmp_path / "d"
    )
    assert read_transitions(tmp_path / "d").system.state.names == [
        "track[0] m",
        "hinge[0] rad",
        "track.velocity[0] m/s",
        "hinge.velocity[0] rad/s",
    ]
    toml.write_text(toml.read_text().replace("push = [-5.0, 5.0]", "push = [-4.0, 4.0]"))
    name, definition, n = resolve(str(toml))
    with pytest.raises(NeuroAnimatorError, match="holds another dataset"):
        generate(
            DatasetConfig(system=name, definition=definition, substeps=n, count=120),
            tmp_path / "d",
        )


def test_goals_are_no_physics_and_a_dataset_takes_new_ones(
    toml: Path, proposed: str, tmp_path: Path
):
    folder = tmp_path / "d"

    def generated(goals: str) -> bytes:
        toml.write_text(proposed + goals)
        name, definition, n = resolve(str(toml))
        generate(DatasetConfig(system=name, definition=definition, substeps=n, count=120), folder)
        return (folder / "shard-00000.safetensors").read_bytes()

    first = generated("")
    age = (folder / "shard-00000.safetensors").stat().st_mtime_ns
    assert generated('[goals.up]\nreach = { "hinge" = [3.1416] }\n') == first
    assert list(read_transitions(folder).system.goals) == ["up"]
    assert generated('[goals.side]\nreach = { "hinge" = [1.5] }\n') == first
    assert list(read_transitions(folder).system.goals) == ["side"]
    assert (folder / "shard-00000.safetensors").stat().st_mtime_ns == age


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("fish.xml", "my-fish"),
        ("My Robot (v2).xml", "my-robot-v2"),
        ("2.xml", "my-2"),
        ("ünïcode.xml", "n-code"),
        ("---.xml", "my"),
    ],
)
def test_any_file_name_makes_a_name_of_its_own(file: str, name: str):
    assert usual_name(Path(file)) == name


def test_a_system_is_called_what_its_user_says(cart: Path):
    path, proposal = write_definition(str(cart), name="trolley")
    assert proposal.definition.name == "trolley"
    assert 'name = "trolley"' in path.read_text()
    for bad, why in (("fish", "is a system of the package"), ("a/b", "wanted letters, digits")):
        with pytest.raises(ArgumentError, match=why):
            write_definition(str(cart), name=bad, force=True)
    assert 'name = "trolley"' in path.read_text()
