"""What the data of a proposal begin with and show: rest, keyframes, and bodies that stand or fly, not what has fallen."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator import DatasetConfig, TrainingConfig, load_system, train
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.data.shard import make_shard
from neuroanimator.physics.loading import resolve
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.scaffold.proposal import Proposal
from neuroanimator.scaffold.write_toml import write_definition

MODELS = Path(__file__).parent / "models"
"""Models of the kinds that strangers bring."""

TALL = """<mujoco><worldbody><geom type="plane" size="5 5 1"/>
  <body name="pole" pos="0 0 0.5"><freejoint name="root"/>
    <geom type="capsule" fromto="0 0 -0.4 0.02 0 0.4" size="0.03"/>
    <body pos="0 0 0.3"><joint name="arm" axis="0 1 0" damping="0.5"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/></body></body>
  </worldbody><actuator><motor name="swing" joint="arm" ctrlrange="-0.5 0.5"/></actuator></mujoco>"""

JOLTED = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.5"/></body></worldbody>
  <actuator><motor joint="hinge" ctrlrange="-1 1"/></actuator>
  <keyframe><key name="side" qpos="1.5"/><key name="up" qpos="3.1"/><key name="mad" qvel="1e9"/></keyframe></mujoco>"""


def put(model: str, folder: Path) -> Path:
    path = folder / f"{model}.xml"
    path.write_bytes((MODELS / path.name).read_bytes())
    return path


def proposed(path: str | Path, toml: Path) -> ModelSystem:
    write_definition(str(path), toml)
    system = load_system(str(toml))
    assert isinstance(system, ModelSystem)
    return system


def share_upright(system: ModelSystem, states: np.ndarray) -> float:
    """Return in which share of `states` (N, S) the root leans by less than 1 rad and is off the ground."""
    data = mujoco.MjData(system.model)
    system.put(data, system.rest)
    mujoco.mj_fwdPosition(system.model, data)
    own_up = data.xmat[1].reshape(3, 3).T @ [0.0, 0.0, 1.0]
    upright = 0
    for state in states:
        system.put(data, state)
        mujoco.mj_fwdPosition(system.model, data)
        touching = system.model.geom_bodyid[data.contact.geom]
        lies = any(set(pair) == {0, 1} for pair in touching.reshape(-1, 2).tolist())
        upright += (data.xmat[1].reshape(3, 3) @ own_up)[2] > np.cos(1.0) and not lies
    return upright / len(states)


@pytest.fixture(scope="module")
def jolted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Proposal]:
    """The TOML file of a model with keyframes, one of which is mad, and its proposal."""
    folder = tmp_path_factory.mktemp("jolted")
    (folder / "jolted.xml").write_text(JOLTED)
    return write_definition(str(folder / "jolted.xml"), keyframe="up")


@pytest.mark.parametrize("model", [pytest.param("drone", marks=pytest.mark.endurance), "quadruped"])
def test_most_of_the_data_are_of_bodies_that_stand_or_fly(model: str, tmp_path: Path):
    toml, proposal = write_definition(str(put(model, tmp_path)))
    assert "upright for" in dict(proposal.told)["trial runs"]
    assert "none, as it falls; upright for" in toml.read_text()
    name, definition, substeps = resolve(str(toml))
    system = load_system(name, definition)
    assert isinstance(system, ModelSystem)
    config = DatasetConfig.usual(name, definition, substeps, count=600)
    states = make_shard(system, config, 0, threads=2).tensors["states"]
    assert share_upright(system, states[:, ::4].reshape(-1, states.shape[-1]).astype(float)) > 0.5
    if model == "drone":
        # What only its controls hold in the air has room to fall.
        assert system.sampling.height[1] > 1.0


def test_what_no_control_holds_upright_keeps_its_whole_controls_and_is_said_to_fall(tmp_path: Path):
    (tmp_path / "tall.xml").write_text(TALL)
    _, proposal = write_definition(str(tmp_path / "tall.xml"))
    assert proposal.definition.control["swing"] == (-0.5, 0.5)
    assert proposal.definition.sampling.warm_up == 0
    assert any("so most of the data are of falls" in text for text in proposal.warnings)


def test_rest_and_keyframes_are_always_among_the_starts(jolted: tuple[Path, Proposal]):
    toml, proposal = jolted
    assert any("keyframe mad: runs that begin there diverge" in line for line in proposal.warnings)
    system = load_system(str(toml))
    starts = sample_starts(system, np.random.default_rng(0), 400)
    for pose in (3.1, 1.5):
        assert (starts == [pose, 0.0]).all(axis=1).mean() > 0.01


def test_a_definition_that_says_nothing_of_resets_keeps_its_data(jolted: tuple[Path, Proposal]):
    toml, _ = jolted
    lines = [line for line in toml.read_text().splitlines() if not line.startswith("reset_")]
    silent = toml.with_name("silent.toml")
    silent.write_text("\n".join(lines))
    _, definition, _ = resolve(str(silent))
    assert "reset_share" not in definition


@pytest.mark.endurance
def test_gymnasiums_ant_begins_where_its_environment_resets(tmp_path: Path):
    system = proposed("Ant-v5", tmp_path / "ant.toml")
    assert system.sampling.reset_noise == 0.1
    starts = sample_starts(system, np.random.default_rng(0), 200)
    [ankle] = [view for view in system.views if view.name == "ankle_1"]
    low, _ = system.model.jnt_range[ankle.index]
    # It stands with its ankles outside of their range.
    assert np.abs(starts[:, ankle.position_entry]).min() < 0.1 < low
    assert np.mean(starts[:, ankle.position_entry] < low - 0.2) > 0.05


@pytest.mark.endurance
def test_the_ant_is_trusted_where_it_stands_after_a_short_training(tmp_path: Path):
    system = proposed("Ant-v5", tmp_path / "ant.toml")
    name, definition, substeps = resolve(str(tmp_path / "ant.toml"))
    config = DatasetConfig.usual(name, definition, substeps, count=18_000)
    data = simulate_transitions(config)
    training = TrainingConfig.usual(data.system.structure, updates=800, widths=(64, 64))
    emulator = train(data, training, tmp_path / "ant.safetensors")
    # It was 3.5 where the data never began at rest.
    assert emulator.trust(system.rest[None], np.array([system.bounds.idle])) < 1
