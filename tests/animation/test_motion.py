"""Motions of systems that name no rates: from `new` to a clip."""

from __future__ import annotations

import csv
import random
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import (
    DatasetConfig,
    Emulator,
    TrainingConfig,
    generate,
    make_clip,
    read_transitions,
    train,
)
from neuroanimator.animation.motion import random_drive
from neuroanimator.physics.loading import resolve
from neuroanimator.scaffold.write_toml import write_definition

TANK = """\
import numpy as np

STEP = 0.1
STATE = {"level": ("m", 2), "valve": "rad"}
CONTROL = {"pump": ("m3/s", 0.0, 0.02)}
ANGLES = ["valve"]
SPREAD = {"level": 0.4, "valve": 3.0}
REST = {"level": 0.5}


def step(state, control, dt):
    flow = 0.1 * np.sqrt(np.maximum(state[:2], 0))
    return state + dt * np.array([control[0] - flow[0], flow[0] - flow[1], 10 * control[0]])
"""


def write_tank(folder: Path) -> Path:
    path = folder / "tank.py"
    path.write_text(TANK)
    return path


def write_noisy_recording(folder: Path) -> Path:
    """Write an angle and a place with so much noise that neither's rate of change is anywhere to be seen."""
    path, draw = folder / "noisy.csv", random.Random(1)
    with open(path, "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["run", "time s", "state.angle rad", "state.position m", "control.motor N"])
        for run in range(6):
            angle = speed = 0.0
            for k in range(300):
                motor = draw.uniform(-1, 1)
                speed += 0.02 * (motor - 4 * angle - 0.3 * speed)
                angle += 0.02 * speed
                table.writerow(
                    [run, f"{k * 0.02:.2f}", angle + draw.gauss(0, 0.01), draw.gauss(0, 0.1), motor]
                )
    return path


@pytest.mark.parametrize("write", [write_tank, write_noisy_recording])
def test_what_names_no_rates_is_animated(write, tmp_path: Path):
    toml, _ = write_definition(str(write(tmp_path)))
    name, definition, substeps = resolve(str(toml))
    config = DatasetConfig(
        system=name, definition=definition, substeps=substeps, count=1224, samples_per_run=36
    )
    generate(config, tmp_path / "data")
    path = tmp_path / "own.emulator.safetensors"
    train(
        read_transitions(tmp_path / "data"),
        TrainingConfig(updates=250, widths=(8,), batch=64),
        path,
    )
    emulator = Emulator.load(path)
    assert emulator.rates == ()
    clip = make_clip(emulator, random_drive(emulator, 2.0, seed=1).motion(emulator))
    assert np.isfinite(clip.states).all()
    assert clip.times[-1] == pytest.approx(2.0)
