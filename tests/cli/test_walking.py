"""From `new Hopper-v5` to a policy's returns and its film, as a user types it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli
from soft_bodies import hasty_emulator

from neuroanimator.cli.policy_returns import emulator_rows
from neuroanimator.physics.loading import trust_files

FILE = "hop.policy.safetensors"


@pytest.mark.endurance
def test_a_hopper_from_new_to_its_film(cli: Cli, tmp_path: Path):
    def told(*arguments: str) -> str:
        done = cli(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return done.stdout

    told("new", "Hopper-v5")
    trust_files(tmp_path / "Hopper-v5.toml")
    emulator = hasty_emulator(tmp_path / "Hopper-v5.toml", tmp_path, substeps=4)
    emulator.save(tmp_path / "leaps.emulator.safetensors")
    learn = ("policy", "Hopper-v5.toml", "--emulator", "leaps.emulator.safetensors", "--out", FILE)
    assert "4,096" in told(*learn, "--updates", "1")
    assert "8,192" in told(*learn, "--updates", "2"), "it did not go on where it was"
    earned = json.loads(told("evaluate", FILE, "--episodes", "2", "--json", "--report", "r.html"))
    assert 0 < earned["least_return"] <= earned["mean_return"] <= earned["largest_return"] < 3000
    assert (tmp_path / "r.html").read_text().count("<svg") == 2
    told("animate", FILE, "--seconds", "0.2", "--out", "hop.glb")
    assert (tmp_path / "hop.glb").stat().st_size > 1000
    assert "11 of 12" in told("info", FILE)
    refused = cli("animate", FILE, "--start", "rootz=1", "--out", "hop.glb", cwd=tmp_path)
    assert refused.returncode == 2
    assert "start: a policy determines its own start" in refused.stderr


@pytest.mark.parametrize(
    ("inside", "word"), [(80.0, "too low"), (95.0, ""), (105.0, ""), (120.0, "too high")]
)
def test_an_emulator_that_earns_too_much_or_too_little_is_called_useless(inside: float, word: str):
    rows = emulator_rows(np.array([90.0, 110.0]), np.array([inside, inside]))
    assert bool(rows) == bool(word)
    assert all("useless" in str(text) and word in str(text) for _, text in rows)
