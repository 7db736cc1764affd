"""Training killed at many moments, also while it writes a checkpoint. One kill is in tests/learn/training/test_train.py."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from processes import killed_at_random, leftovers, run
from tally import Tally

from neuroanimator.learn.training.train import run_folder

SMALL = ("--widths", "16,16", "--updates", "20000", "--batch", "16")


@pytest.mark.endurance
def test_f02_killed_at_many_moments_it_ends_with_the_same_bytes(
    dataset: Path, tmp_path: Path, tally: Tally
):
    whole, broken = tmp_path / "whole.safetensors", tmp_path / "broken.safetensors"
    assert run("train", dataset, "--out", whole, *SMALL).returncode == 0
    rng = random.Random(0)
    for _ in range(12):
        tally.tried += killed_at_random(rng, 15.0, "train", dataset, "--out", broken, *SMALL)
    assert run("train", dataset, "--out", broken, *SMALL).returncode == 0
    tally.expect(broken, whole.read_bytes())
    tally.expect(
        run_folder(broken) / "checkpoint.safetensors",
        (run_folder(whole) / "checkpoint.safetensors").read_bytes(),
    )
    assert not leftovers(tmp_path)
