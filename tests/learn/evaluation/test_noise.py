"""Noise of recordings is told from motion, and an emulator is not blamed for what it makes of errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroanimator import (
    DatasetConfig,
    NeuroAnimatorError,
    TrainingConfig,
    evaluate,
    generate,
    read_transitions,
    train,
    write_report,
)
from neuroanimator.emulator.verdict import beyond_noise, judge
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.learn.data.recorded_noise import noise_of
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.baselines import CONSTANT_VELOCITY, NO_CHANGE
from neuroanimator.learn.evaluation.evaluate import EvaluationBudget
from neuroanimator.physics.loading import resolve
from neuroanimator.scaffold.write_toml import write_definition

FAST = EvaluationBudget(repeats=1, starts=20, steps=50)
SHARE = 0.12
"""An estimate of noise is right to within this share."""


def pendulum(
    noise: float, *, step: float = 0.01, hold: int = 20, is_smooth: bool = False
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return states (angle, rate) and controls of ten runs of a driven pendulum; the rate has five times the noise."""
    rng = np.random.default_rng(0)
    states = []
    controls = []
    for _ in range(10):
        angle = rng.uniform(-3, 3)
        rate = 0.0
        torque = 0.0
        phases = rng.uniform(0, 6, 3)
        rows = []
        held = []
        for k in range(300):
            if is_smooth:
                torque = np.sin(step * k * np.array([2.0, 4.1, 6.7]) + phases).sum()
            elif k % hold == 0:
                torque = rng.uniform(-2, 2)
            rows.append((angle, rate))
            held.append((torque,))
            for _ in range(10):
                rate += step / 10 * (3 * torque - 15 * np.sin(angle) - 0.3 * rate)
                angle += step / 10 * rate
        states.append(np.array(rows) + rng.normal(size=(300, 2)) * [noise, 5 * noise])
        controls.append(np.array(held))
    return states, controls


@pytest.mark.parametrize("noise", [1e-4, 0.01, 0.1])
@pytest.mark.parametrize(
    "drive",
    [
        {"hold": 20},
        {"hold": 4, "step": 0.03},
        {"hold": 1},  # kinks at every sample
        {"is_smooth": True},
    ],
    ids=str,
)
def test_known_noise_is_recovered_whatever_drives_the_motion(noise: float, drive: dict):
    found = noise_of(*pendulum(noise, **drive))
    np.testing.assert_allclose(found, [noise, 5 * noise], rtol=SHARE)


@pytest.mark.parametrize("drive", [{"hold": 20}, {"is_smooth": True}], ids=str)
def test_motion_without_noise_has_none(drive: dict):
    states, controls = pendulum(0.0, **drive)
    assert (noise_of(states, controls) < 1e-6 * np.std(np.concatenate(states), axis=0)).all()


def test_impacts_and_rounding_are_no_noise():
    rng = np.random.default_rng(0)
    time = np.arange(4000) * 0.01
    bouncing = np.abs(np.sin(3 * time)) + 0.001 * rng.normal(size=4000)
    rounded = np.round(np.sin(time), 3)
    found = noise_of([np.stack([bouncing, rounded], axis=1)], [np.sin(time)[:, None]])
    assert found[0] == pytest.approx(0.001, rel=SHARE)
    assert found[1] < 0.001


def write_recording(path: Path, noise: float) -> None:
    """Write a spring's motion, whose rate has five times the noise, sampled at 50 Hz."""
    rng = np.random.default_rng(1)
    lines = ["run,time s,state.angle rad,state.rate rad/s,control.torque N·m"]
    for run in range(8):
        angle = rng.uniform(-1, 1)
        rate = 0.0
        for k in range(400):
            torque = np.sin(0.02 * k * np.array([1.0, 2.3, 4.1]) + run).sum()
            seen = angle + noise * rng.normal()
            seen_rate = rate + 5 * noise * rng.normal()
            lines.append(f"{run},{k * 0.02:.2f},{seen:.6f},{seen_rate:.6f},{torque:.5f}")
            for _ in range(20):
                rate += 0.001 * (6 * torque - 16 * angle - rate)
                angle += 0.001 * rate
    path.write_text("\n".join(lines))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Transitions:
    folder = tmp_path_factory.mktemp("noisy")
    write_recording(folder / "noisy.csv", 0.05)
    name, definition, _ = resolve(str(write_definition(str(folder / "noisy.csv"))[0]))
    config = DatasetConfig(system=name, definition=definition, substeps=5)
    generate(config, folder / "data")
    return read_transitions(folder / "data")


def test_an_emulator_as_exact_as_the_noise_is_not_called_poor(data: Transitions, tmp_path: Path):
    settings = TrainingConfig(updates=500, widths=(16,), batch=128)
    emulator = train(data, settings, tmp_path / "noisy.emulator.safetensors")
    found = evaluate(emulator, data=data, budget=FAST)
    assert found.noise is not None
    np.testing.assert_allclose(found.noise, [0.05, 0.25], rtol=SHARE)
    assert found.noise_error == pytest.approx(found.one_step_error, rel=SHARE)
    assert found.one_step_error > 0.1  # which without noise would not be good
    assert found.verdict.word == "good"
    assert "of which the recordings' own noise makes" in str(found.verdict)
    assert "The recordings' own noise (angle[0] 0.05 rad" in found.note
    assert found.row()["noise_error"] == found.noise_error
    write_report([found], tmp_path / "report.html")
    assert "Noise of the recordings" in (tmp_path / "report.html").read_text()


def test_only_what_is_beyond_the_noise_is_held_against_an_emulator():
    cheap = {NO_CHANGE: 1.0, CONSTANT_VELOCITY: 0.8}
    assert judge(0.6, cheap).word == "poor"
    assert judge(0.6, cheap, noise=0.55).word == "usable"
    assert judge(0.6, cheap, noise=0.599).word == "good"
    assert judge(1.1, cheap).word == "useless"
    assert judge(1.1, cheap, noise=0.5).word == "useless"
    assert judge(1.1, cheap, noise=1.09).word != "useless"
    assert beyond_noise(0.5, 0.3) == pytest.approx(0.4)


def test_a_dataset_of_an_older_version_has_no_noise_and_a_wrong_one_is_refused(
    tmp_path_factory: pytest.TempPathFactory, data: Transitions
):
    folder = tmp_path_factory.mktemp("old")
    write_recording(folder / "noisy.csv", 0.05)
    write_definition(str(folder / "noisy.csv"))
    generate(data.config, folder / "data")
    path = folder / "data" / "held-out.safetensors"
    tensors, _ = read_tensors(path, "held-out")
    metadata = {"kind": "held-out", "config": data.config.hash}
    noise = tensors.pop("noise")
    write_tensors(path, tensors, metadata)
    assert read_transitions(folder / "data").noise is None
    write_tensors(path, tensors | {"noise": -noise}, metadata)
    with pytest.raises(NeuroAnimatorError, match="the noise is not a number of 0 or more"):
        read_transitions(folder / "data")
