"""Recordings cannot be simulated: controllers of theirs are found on the emulator alone, and said to be unproved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Cli

import neuroanimator as na
from neuroanimator.control.synthesis.summary import UNPROVED, outcome_rows
from neuroanimator.learn.planning.pursue import pursue_goal
from neuroanimator.physics.loading import resolve
from neuroanimator.scaffold.write_toml import write_definition

GOAL = """
[goals.aside]
seconds = 1.5
reach = { angle = [0.6], velocity = [0.0] }
within = { angle = 0.1, velocity = 0.3 }
start = { angle = [0.0], velocity = [0.0] }
"""


def write_recording(path: Path) -> None:
    """Write a spring's motion under torques that change every 0.2 s, sampled at 50 Hz through a little noise."""
    rng = np.random.default_rng(0)
    lines = ["run,time s,state.angle rad,state.velocity rad/s,control.torque N·m"]
    for run in range(6):
        angle = rng.uniform(-1, 1)
        velocity = 0.0
        torque = 0.0
        for row in range(300):
            if row % 10 == 0:
                torque = rng.uniform(-2, 2)
            seen = angle + 0.002 * rng.normal()
            seen_velocity = velocity + 0.01 * rng.normal()
            lines.append(f"{run},{row * 0.02:.2f},{seen:.5f},{seen_velocity:.5f},{torque:.4f}")
            for _ in range(20):
                velocity += 0.001 * (5 * torque - 9 * angle - velocity)
                angle += 0.001 * velocity
    path.write_text("\n".join(lines))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with spring.csv, spring.toml, data and an emulator; the goal is added after training."""
    folder = tmp_path_factory.mktemp("spring")
    write_recording(folder / "spring.csv")
    toml, _ = write_definition(str(folder / "spring.csv"))
    system = na.load_system(str(toml))
    config = na.DatasetConfig(system=system.name, definition=system.definition_text, substeps=5)
    na.generate(config, folder / "data")
    settings = na.TrainingConfig(updates=500, widths=(16,), batch=128)
    na.train(na.read_transitions(folder / "data"), settings, folder / "spring.emulator.safetensors")
    toml.write_text(toml.read_text() + GOAL)
    return folder


def test_a_goal_written_after_training_is_reached_on_the_emulator_and_nothing_is_proved(
    folder: Path,
):
    emulator = na.load_emulator(folder / "spring.emulator.safetensors")
    system = na.load_system(str(folder / "spring.toml"))
    found = na.control.synthesise_goal(
        emulator, system, "aside", options=na.SearchOptions(measures_trust=True)
    )
    assert found.is_reached
    assert not found.outcome.is_on_physics
    assert found.trust is None
    assert found.spent.physics_steps == found.spent.corrections == found.spent.refinements == 0
    np.testing.assert_array_equal(found.outcome.physics_states, found.outcome.emulator_states)
    rows = dict(outcome_rows(found))
    assert rows["in words"] == UNPROVED
    scores = emulator.trust(found.outcome.emulator_states[:-1], found.controls)
    within = np.mean(scores <= 1)
    told = str(rows["trust in the emulator's motion"])
    assert told.startswith("all of it" if within == 1 else f"{within:.0%} of it")
    assert "J on physics" not in rows


def test_in_closed_loop_the_emulator_is_driven(folder: Path):
    emulator = na.load_emulator(folder / "spring.emulator.safetensors")
    system = na.load_system(str(folder / "spring.toml"))
    pursuit = pursue_goal(emulator, system, "aside", guesses=4)
    assert not pursuit.is_on_physics
    motion = pursuit.motion
    again = emulator.rollout(motion.states[0], motion.controls)
    np.testing.assert_allclose(motion.states, again, atol=1e-5)


def test_control_says_in_words_that_nothing_proves_it_and_draws_the_emulator(
    folder: Path, cli: Cli
):
    emulator = "spring.emulator.safetensors"
    options = ("--system", "spring.toml", "--out", "c.csv", "--glb", "c.glb")
    for more in ((), ("--closed-loop",)):
        result = cli("control", emulator, *options, *more, cwd=folder)
        assert result.returncode == 0, result.stderr
        assert "verifies nothing" in result.stdout
        assert "physics" not in result.stdout
    assert b"ghost" not in (folder / "c.glb").read_bytes()


def test_a_goal_makes_no_other_dataset(folder: Path):
    data = na.read_transitions(folder / "data")
    name, definition, _ = resolve(str(folder / "spring.toml"))
    config = data.config.model_copy(update={"definition": definition})
    assert config.hash == data.config.hash
    stamp = (folder / "data" / "shard-00000.safetensors").stat().st_mtime_ns
    na.generate(config, folder / "data")
    assert (folder / "data" / "shard-00000.safetensors").stat().st_mtime_ns == stamp
    assert list(na.read_transitions(folder / "data").system.goals) == ["aside"]
    with pytest.raises(na.NeuroAnimatorError, match="holds another dataset"):
        na.generate(
            na.DatasetConfig(system=name, definition=definition, substeps=4), folder / "data"
        )
