"""Super steps follow what is slow and what is noisy, and slow systems go all the way."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli
from small_trainings import small_training

import neuroanimator as na
from neuroanimator.scaffold.scales import (
    MAX_CHANGE,
    fastest_rate,
    share_of_change,
    share_of_noise,
    slow_substeps,
)
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.state.slowness import slowness

RATE = 1 / 1800
"""The room forgets so fast where it began [1/s]."""

ROOM = f"""\
import numpy as np

STEP = 60.0
STATE = {{"air": "K"}}
CONTROL = {{"heater": ("W", 0.0, 2000.0)}}
REST = {{"air": 293.0}}
SPREAD = {{"air": 5.0}}


def step(state, control, dt):
    return np.array([state[0] + dt * {RATE} * (290.0 - state[0] + 0.003 * control[0])])
"""

DISC = """\
import numpy as np

STEP = 0.01
STATE = {"angle": "rad", "rate": "rad/s"}
CONTROL = {"motor": ("N·m", -1.0, 1.0)}


def step(state, control, dt):
    rate = state[1] + dt * (8.0 * control[0] - 0.5 * state[1])
    return np.array([(state[0] + dt * rate) % (2 * np.pi), rate])
"""


def decaying(noise: float, rows: int = 4000) -> np.ndarray:
    """Return samples (N, 1) of something pushed at random that forgets at `RATE`, sampled every minute."""
    rng = np.random.default_rng(0)
    pushes = np.repeat(rng.normal(size=rows // 40), 40)
    values = [0.0]
    for push in pushes[:-1]:
        values.append(values[-1] + 60 * RATE * (push - values[-1]))
    return (np.array(values) + noise * rng.normal(size=rows))[:, None]


def test_the_rate_of_a_step_function_is_that_of_its_equation():
    matrix = np.array([[-0.5, 2.0], [-2.0, -0.5]])
    states = np.random.default_rng(0).normal(size=(20, 2))
    found = fastest_rate(lambda states: states + 0.001 * states @ matrix.T, states, 0.001)
    assert found == pytest.approx(np.hypot(0.5, 2.0), rel=1e-3)


def test_shares_of_change_and_noise_are_what_was_put_in():
    noise = np.array([0.05])
    clean = decaying(0.0)
    noisy = decaying(0.05)
    for span in (1, 5, 20):
        expected = share_of_change([clean], np.zeros(1), span)
        np.testing.assert_allclose(share_of_change([noisy], noise, span), expected, atol=0.02)
        change = noisy[span:] - noisy[:-span]
        expected_noise = np.sqrt(2) * 0.05 / change.std()
        assert share_of_noise([noisy], noise, span) == pytest.approx(expected_noise)
    n = slow_substeps([clean], np.zeros(1), 1)
    assert share_of_change([clean], np.zeros(1), n)[0] <= MAX_CHANGE
    assert share_of_change([clean], np.zeros(1), n + 1)[0] > MAX_CHANGE


def write_recording(path: Path, noise: float) -> None:
    values = decaying(noise)[:, 0]
    rng = np.random.default_rng(0)
    pushes = np.repeat(rng.normal(size=100), 40)
    lines = ["time s,state.air K,control.heater 1"]
    for row in range(len(values)):
        lines.append(f"{60 * row},{values[row]:.6f},{pushes[row]:.5f}")
    path.write_text("\n".join(lines))


def test_noise_makes_super_steps_of_recordings_longer(tmp_path: Path):
    substeps = {}
    for noise in (0.0, 0.1):
        write_recording(tmp_path / "room.csv", noise)
        toml, proposal = write_definition(str(tmp_path / "room.csv"), force=True)
        substeps[noise] = proposal.definition.substeps
    assert 1 < substeps[0.0] < substeps[0.1]
    assert "of the changes in it are noise" in toml.read_text()


def test_a_super_step_of_a_slow_function_is_a_share_of_its_time(tmp_path: Path):
    (tmp_path / "room.py").write_text(ROOM)
    _, proposal = write_definition(str(tmp_path / "room.py"))
    dt = 60.0 * proposal.definition.substeps
    assert dt * RATE == pytest.approx(MAX_CHANGE, abs=61 * RATE)


def test_slow_systems_go_all_the_way(cli: Cli, tmp_path: Path):
    (tmp_path / "room.py").write_text(ROOM)
    emulator = "room.emulator.safetensors"
    for arguments in (
        ("new", "room.py"),
        ("generate", "room.toml", "--count", "2400", "--out", "data"),
        (
            "train",
            "data",
            *small_training(500, "16", 128),
            "--out",
            emulator,
        ),
        ("animate", emulator, "--out", "clip.csv", "--out", "clip.glb"),
    ):
        result = cli(*arguments, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
    goal = "[goals.warm]\nseconds = 7200.0\nreach = { air = [294.0] }\nwithin = { air = 0.2 }\n"
    toml = tmp_path / "room.toml"
    toml.write_text(toml.read_text() + goal)
    result = cli("control", emulator, "--system", "room.toml", "--out", "c.csv", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert re.search(r"goal reached on the true physics +yes", result.stdout)
    found = na.evaluate(
        na.load_emulator(tmp_path / emulator),
        budget=na.EvaluationBudget(runs=4, transitions=100, repeats=1, starts=10, steps=50),
    )
    assert found.one_step_error < 0.1
    assert len(found.times) > 20
    assert found.rollout_error_at(1.0) > 0


def test_only_slow_systems_are_given_other_times():
    assert slowness(0.1) == slowness(0.5) == 1.0
    assert slowness(60.0) == 600.0


def test_an_angle_that_may_stand_anywhere_goes_on_where_the_function_wraps_it(tmp_path: Path):
    (tmp_path / "disc.py").write_text(DISC)
    toml, proposal = write_definition(str(tmp_path / "disc.py"))
    assert proposal.definition.state[0].feature == "cyclic"
    system = na.load_system(str(toml))
    start = np.array([[6.0, 5.0]])
    angles = system.simulate(start, np.zeros((1, 100, 1)), 0.01).states[0, :, 0]
    assert np.abs(np.diff(angles)).max() < 0.06
    assert angles[-1] > 2 * np.pi
