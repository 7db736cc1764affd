"""A school to look at: it stays together, level and apart, and goes along."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Cli

from neuroanimator import load_policy
from neuroanimator.control.policies.school import school_motion


@pytest.mark.parametrize("name", ["fish", pytest.param("dolphin", marks=pytest.mark.endurance)])
def test_a_school_stays_together_level_and_apart(name: str):
    policy = load_policy(name)
    states = school_motion(policy, 12, 5.0, seed=3)
    pose = policy.pose(np.asarray(policy.emulator.encode(states)))
    positions = np.asarray(pose.position)
    length = float(np.ptp(policy.emulator.rest[:69:3]))
    offsets = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    apart = offsets + 9 * length * np.eye(12)[:, :, None]
    assert apart.min() > 0.4 * length
    assert offsets.max() < 8 * length
    assert np.degrees(np.arcsin(np.abs(pose.forward[..., 2]))).max() < 40
    assert (positions[:, -1, 0] - positions[:, 0, 0] > length).all()
    # None beats in time with another.
    assert np.ptp(states[:, 20, :69] - states[:1, 20, :69], axis=0).max() > 1e-3


def test_a_school_is_written_and_what_it_cannot_be_is_refused(cli: Cli, tmp_path: Path):
    out = tmp_path / "school.glb"
    done = cli("animate", "fish", "--school", "3", "--seconds", "0.2", "--out", out)
    assert done.returncode == 0, done.stderr
    content = out.read_bytes()
    assert b'"fish_3_root"' in content
    for arguments, message in (
        (
            ["lander", "--school", "3"],
            "no policy of lander ships. Systems with one: dolphin, fish, trout, orca.",
        ),
        (["fish", "--school", "65"], "wanted 1 to 64 bodies, got 65"),
        (
            ["fish", "--school", "2", "--start", "body.heading=1"],
            "start: a school is steered by its",
        ),
        (["fish", "--school", "2", "--out", "a.csv"], "'a.csv': a .csv holds one body"),
    ):
        refused = cli("animate", *arguments, "--out", tmp_path / "b.glb")
        assert refused.returncode == 2
        assert message in refused.stderr
        assert not (tmp_path / "b.glb").exists()
