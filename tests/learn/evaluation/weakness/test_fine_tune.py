"""Learning from a recording: errors on its unseen tail fall, and what is wrong with it is told by line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Cli
from small_trainings import small_training

from neuroanimator import ImprovementConfig, NeuroAnimatorError, fine_tune, load_system
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.weakness.fine_tune import read_runs, split
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.state.columns import column_names
from neuroanimator.systems.random_controls import sample_controls

CONFIG = ImprovementConfig(updates=500)
RATE = 5
"""Samples in a super step."""
WEAKER = 0.6
"""The motors of the recorded pendulum give so much of what is recorded."""


def header(emulator: Emulator) -> str:
    states = [f"state.{name}" for name in column_names(emulator.state)]
    controls = [f"control.{name}" for name in column_names(emulator.control)]
    return ",".join(["run", "time s", *states, *controls])


def lines_of(emulator: Emulator, runs: int = 6, seconds: float = 6.0) -> list[str]:
    """Return the recording of a pendulum with weak motors, a line a sample."""
    system = load_system("pendulum")
    step = emulator.dt / RATE
    steps = round(seconds / emulator.dt)
    rng = np.random.default_rng(5)
    lines = [header(emulator)]
    for run in range(runs):
        held = sample_controls(rng, steps, emulator.dt, system.bounds)
        controls = np.repeat(held, RATE, axis=0)
        states = system.simulate(system.rest[None], WEAKER * controls[None], step).states[0]
        for k, (state, control) in enumerate(zip(states, controls, strict=False)):
            cells = [str(run), repr(k * step), *map(repr, map(float, (*state, *control)))]
            lines.append(",".join(cells))
    return lines


@pytest.fixture(scope="module")
def recording(shipped: Emulator, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "weak motors.csv"
    path.write_text("\n".join([*lines_of(shipped), ""]))
    return path


def test_errors_on_a_recordings_unseen_tail_fall(
    shipped: Emulator, transitions: Transitions, recording: Path, tmp_path: Path
):
    out = tmp_path / "e.safetensors"
    result = fine_tune(shipped, recording, out, config=CONFIG, data=transitions)
    tail, usual = result.errors
    assert (tail.distribution, usual.distribution) == (str(recording), "usual")
    assert tail.after < 0.7 * tail.before
    # The motors are weaker than in what it knew, so that both cannot be right.
    assert usual.after < tail.before
    again = fine_tune(shipped, recording, out, config=CONFIG, data=transitions)
    assert again.errors == result.errors


def test_the_tail_is_not_learnt_from(
    shipped: Emulator, transitions: Transitions, recording: Path, tmp_path: Path
):
    learning, tail = split(read_runs(recording, shipped))
    learnt = {state.astype(np.float32).tobytes() for state in learning.states.reshape(-1, 6)}
    tested = {state.astype(np.float32).tobytes() for state in tail.states.reshape(-1, 6)}
    assert len(tested) > 500
    assert not learnt & tested


def test_a_recordings_super_steps_are_those_of_the_emulator(shipped: Emulator, recording: Path):
    states, controls = read_runs(recording, shipped).windows(0, np.zeros(1, int), 20)
    system = load_system("pendulum")
    again = system.simulate(states[:, 0], WEAKER * controls, shipped.dt)
    assert np.allclose(again.states, states, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda lines: [
                *lines[:41],
                lines[41].replace(lines[41].split(",")[3], "nan"),
                *lines[42:],
            ],
            r"r.csv, line 42, column 4 \(state.angle.1 rad\): wanted a finite number, got 'nan'",
        ),
        (
            lambda lines: [line.replace("state.angle.0", "state.tilt") for line in lines],
            r"r.csv, line 1, column 3: 'tilt' is no column of the emulator. Columns: state.angle.0",
        ),
        (
            lambda lines: lines[::3],
            r"r.csv: sampled every 0.03 s; the emulator's super step of 0.05 s is not a whole multiple of that",
        ),
        (lambda lines: lines[:40], r"r.csv: 11 windows to learn from .* Record longer"),
        (lambda lines: lines[:1], r"r.csv: 0 rows"),
    ],
)
def test_what_is_wrong_with_a_recording_is_told(
    change, told: str, shipped: Emulator, recording: Path, tmp_path: Path
):
    path = tmp_path / "r.csv"
    path.write_text("\n".join([*change(recording.read_text().splitlines()), ""]))
    with pytest.raises(BadFileError, match=told):
        fine_tune(shipped, path, tmp_path / "e.safetensors", config=CONFIG)
    assert [file.name for file in tmp_path.iterdir()] == ["r.csv"]


def test_a_recording_of_another_kind_is_refused(shipped: Emulator, tmp_path: Path):
    with pytest.raises(NeuroAnimatorError, match=r"recordings end in .csv, .npz"):
        fine_tune(shipped, tmp_path / "r.txt", tmp_path / "e.safetensors")


def test_the_verb_learns_from_a_recording(recording: Path, dataset: Path, tmp_path: Path, cli: Cli):
    out = tmp_path / "e.safetensors"
    options = ["--from", recording, "--data", dataset, "--updates", "500", "--out", out]
    done = cli("improve", "pendulum-50", *options)
    assert done.returncode == 0, done.stderr
    assert "weak motors.csv" in done.stdout
    assert out.exists()
    refused = cli("improve", "pendulum-50", *options, "--rounds", "2")
    assert refused.returncode == 2
    assert "rounds: does not go with --from" in refused.stderr


def test_an_emulator_of_recordings_learns_from_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
):
    for name, stiffness in (("old.csv", 16.0), ("new.csv", 20.0)):
        (tmp_path / name).write_text(oscillator(stiffness))
    monkeypatch.chdir(tmp_path)
    toml, _ = write_definition("old.csv")
    small = [
        *small_training(500, "16", 128),
        "--out",
        "e.emulator.safetensors",
    ]
    assert cli("train", toml, *small).returncode == 0
    options = ["improve", "e.emulator.safetensors", "--from", "new.csv", "--updates", "500"]
    alone = cli(*options, "--out", "alone.safetensors")
    assert alone.returncode == 2
    assert "Pass its folder: --data" in alone.stderr
    both = cli(*options, "--data", "e.data", "--out", "both.safetensors")
    assert both.returncode == 0, both.stderr
    before, after = [float(word) for word in both.stdout.splitlines()[1].split()[1:]]
    assert after < before
    assert "usual" in both.stdout.splitlines()[2]


def oscillator(stiffness: float) -> str:
    """Return the recording of an oscillator with this stiffness [1/s²], at 50 Hz."""
    rng = np.random.default_rng(int(stiffness))
    lines = ["run,time s,state.angle rad,state.speed rad/s,control.torque N·m"]
    for run in range(6):
        angle = rng.uniform(-0.5, 0.5)
        speed = 0.0
        phases = rng.uniform(0, 6, 3)
        for k in range(400):
            torque = float(np.sin(0.02 * k * np.array([1.0, 2.3, 4.1]) + phases).sum())
            lines.append(f"{run},{k * 0.02:.2f},{angle:.9g},{speed:.9g},{torque:.9g}")
            for _ in range(20):
                speed += 0.001 * (6 * torque - stiffness * angle - speed)
                angle += 0.001 * speed
    return "\n".join([*lines, ""])
