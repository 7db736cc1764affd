"""What the data of a proposal begin with: rest and keyframes, and what an environment resets to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroanimator import DatasetConfig, TrainingConfig, load_system, train
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.sampling import sample_starts
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.loading import resolve
from neuroanimator.systems.rigid.model_system import ModelSystem

JOLTED = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.5"/></body></worldbody>
  <actuator><motor joint="hinge" ctrlrange="-1 1"/></actuator>
  <keyframe><key name="side" qpos="1.5"/><key name="up" qpos="3.1"/><key name="mad" qvel="1e9"/></keyframe></mujoco>"""


def proposed(path: str | Path, toml: Path) -> ModelSystem:
    write_definition(str(path), toml)
    system = load_system(str(toml))
    assert isinstance(system, ModelSystem)
    return system


def test_rest_and_keyframes_are_always_among_the_starts(tmp_path: Path):
    (tmp_path / "jolted.xml").write_text(JOLTED)
    _, proposal = write_definition(str(tmp_path / "jolted.xml"), tmp_path / "j.toml", keyframe="up")
    assert any("keyframe mad: runs that begin there diverge" in line for line in proposal.warnings)
    system = load_system(str(tmp_path / "j.toml"))
    starts = sample_starts(system, np.random.default_rng(0), 400)
    for pose in (3.1, 1.5):
        assert (starts == [pose, 0.0]).all(axis=1).mean() > 0.01


def test_a_definition_that_says_nothing_of_resets_keeps_its_data(tmp_path: Path):
    (tmp_path / "jolted.xml").write_text(JOLTED)
    toml, _ = write_definition(str(tmp_path / "jolted.xml"))
    lines = [line for line in toml.read_text().splitlines() if not line.startswith("reset_")]
    toml.write_text("\n".join(lines))
    _, definition, _ = resolve(str(toml))
    assert "reset_share" not in definition


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
