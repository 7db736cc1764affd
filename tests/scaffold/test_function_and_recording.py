"""What goes round, what may stand anywhere and what is whose rate is seen in step functions and in noisy recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroanimator import NeuroAnimatorError, load_system
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.scaffold.defaults import MAX_TURN
from neuroanimator.scaffold.write_toml import write_definition

PENDULUM = """\
import numpy as np

STEP = 0.02
STATE = {"theta": "rad", "spin": "rad/s", "cart": "m", "speed": "m/s", "stretch": "m"}
CONTROL = {"torque": ("N·m", -2.0, 2.0)}


def step(state, control, dt):
    theta, spin, cart, speed, stretch = state
    spin = np.clip(spin + (15 * np.sin(theta) + 3 * control[0]) * dt, -8, 8)
    theta = (theta + spin * dt + np.pi) % (2 * np.pi) - np.pi
    following = speed + dt * (np.cos(theta) - speed)
    return np.array([theta, spin, cart + dt * speed, following, 0.9 * stretch + 0.01 * control[0]])
"""


def parts_of(path: Path) -> dict[str, Any]:
    toml, proposal = write_definition(str(path))
    load_system(str(toml))
    definition = proposal.definition
    assert check_table(read_toml(toml), toml.name, type(definition)) == definition
    return {part.name: part for part in proposal.definition.state}


def test_calls_show_what_goes_round_what_stands_anywhere_and_rates(tmp_path: Path):
    (tmp_path / "gym.py").write_text(PENDULUM)
    parts = parts_of(tmp_path / "gym.py")
    features = {name: part.feature for name, part in parts.items()}
    assert features == {
        "theta": "sine", "spin": "plain", "cart": "cyclic", "speed": "plain", "stretch": "plain",
    }  # fmt: skip
    assert {name: part.rate for name, part in parts.items() if part.rate} == {
        "theta": "spin",
        "cart": "speed",
    }


def test_what_the_file_declares_stands(tmp_path: Path):
    declared = PENDULUM.replace("\n\ndef", '\nANGLES = []\nRATES = {"cart": "speed"}\n\ndef', 1)
    (tmp_path / "gym.py").write_text(declared.replace("ANGLES = []", 'ANGLES = ["theta"]'))
    parts = parts_of(tmp_path / "gym.py")
    assert parts["theta"].feature == "sine"
    assert parts["theta"].rate == ""


def test_an_angle_that_a_function_wraps_goes_on_in_runs(tmp_path: Path):
    (tmp_path / "gym.py").write_text(PENDULUM)
    toml, _ = write_definition(str(tmp_path / "gym.py"))
    system = load_system(str(toml))
    start = np.array([[3.0, 7.0, 0.0, 0.0, 0.0]])
    angles = system.simulate(start, np.zeros((1, 20, 1)), 0.02).states[0, :, 0]
    assert angles.max() > np.pi
    assert np.abs(np.diff(angles)).max() < 0.2


def test_a_part_that_never_changes_and_a_control_without_effect_are_named(tmp_path: Path):
    idle = PENDULUM.replace("0.9 * stretch", "stretch").replace("control[0]", "0")
    (tmp_path / "idle.py").write_text(idle)
    _, proposal = write_definition(str(tmp_path / "idle.py"))
    assert "state: stretch[0] m never change" in proposal.warnings[0]
    assert "nothing that step returns depends on it" in proposal.warnings[1]


def recorded(noise: float, wrap: float = 0.0) -> np.ndarray:
    """Return rows (run, time, angle, rate, other, torque) of a driven pendulum, angles from `wrap` to a turn more."""
    rng = np.random.default_rng(0)
    rows = []
    for run in range(6):
        angle = rng.uniform(-3, 3)
        rate = 0.0
        for k in range(300):
            torque = np.sin(0.02 * k * (run + 1))
            seen = (angle + noise * rng.normal() - wrap) % (2 * np.pi) + wrap
            rows.append(
                (run, k * 0.01, seen, rate + 5 * noise * rng.normal(), rng.normal(), torque)
            )
            rate += 0.01 * (3 * torque - 15 * np.sin(angle) - 0.3 * rate)
            angle += 0.01 * rate
    return np.array(rows)


def write_rows(path: Path, rows: np.ndarray) -> Path:
    lines = ["run,time s,state.angle rad,state.rate rad/s,state.other rad/s,control.torque N·m"]
    for run, *numbers in rows:
        lines.append(",".join([f"{run:.0f}", *(f"{number:.6f}" for number in numbers)]))
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("wrap", [0.0, -np.pi])
def test_rates_and_wraps_are_seen_through_noise(tmp_path: Path, noise: float, wrap: float):
    path = write_rows(tmp_path / "runs.csv", recorded(noise, wrap))
    parts = parts_of(path)
    assert parts["angle"].feature == "sine"
    assert parts["angle"].rate == "rate"
    assert parts["other"].rate == ""


def test_the_super_step_of_recordings_follows_how_fast_angles_turn(tmp_path: Path):
    path = write_rows(tmp_path / "runs.csv", recorded(0.01))
    toml, proposal = write_definition(str(path))
    rates = np.abs(recorded(0.0)[:, 3])
    assert proposal.definition.substeps * 0.01 * np.percentile(rates, 95) < 1.2 * MAX_TURN
    assert "in which angles turn by up to" in toml.read_text()


def test_recordings_of_one_state_and_columns_that_never_change_are_named(tmp_path: Path):
    rows = recorded(0.0)
    rows[:, 4] = 1.0
    _, proposal = write_definition(str(write_rows(tmp_path / "still.csv", rows)))
    assert "state.other: the same in every row" in proposal.warnings[0]
    rows[:, 2:5] = 1.0
    with pytest.raises(NeuroAnimatorError, match="the state is the same in every row"):
        write_definition(str(write_rows(tmp_path / "one.csv", rows)))


def test_rest_is_where_a_recording_is_stillest(tmp_path: Path):
    rows = recorded(0.0)
    parts = parts_of(write_rows(tmp_path / "runs.csv", rows))
    rest = np.array([parts["angle"].rest[0], parts["rate"].rest[0]])
    assert abs(np.sin(rest[0])) < 0.3
    assert abs(rest[1]) < 0.2 * np.abs(rows[:, 3]).max()
    assert (np.abs(rows[:, 2:4] - rest).max(axis=1) < 1e-5).any()


def test_an_angle_that_turns_too_fast_to_be_told_is_named(tmp_path: Path):
    rows = recorded(0.0)
    rows[:, 2] = (3.0 * np.arange(len(rows)) + np.pi) % (2 * np.pi) - np.pi
    _, proposal = write_definition(str(write_rows(tmp_path / "fast.csv", rows)))
    assert any("turns by 3 rad and more between two samples" in line for line in proposal.warnings)


def test_a_clock_that_drifts_is_told_from_a_gap(tmp_path: Path):
    rows = recorded(0.0)
    rows[:, 1] += 0.004 * rows[:, 1] ** 2
    with pytest.raises(NeuroAnimatorError, match="the clock drifts or jitters: rows are 0.01"):
        write_definition(str(write_rows(tmp_path / "drift.csv", rows)))
