"""Trainings that fit into some minutes."""

from __future__ import annotations

from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from conftest import Cli

from neuroanimator import ArgumentError, DatasetConfig, TrainingConfig
from neuroanimator.learn.budget import MAX_TIMES, transitions_within, updates_within
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training.train import run_folder

DATA = DatasetConfig(system="pendulum-passive", count=20_000)
SMALL = TrainingConfig(updates=500, widths=(8,), batch=16)


def test_with_much_time_all_the_data_are_made_and_four_times_the_updates(transitions: Transitions):
    assert transitions_within(DATA, 1e6) == DATA.count
    assert updates_within(transitions, SMALL, 1e6) == MAX_TIMES * SMALL.updates


def test_less_time_is_for_fewer_updates(transitions: Transitions):
    some = TrainingConfig(updates=10_000_000, widths=(8,), batch=16)
    within = [updates_within(transitions, some, seconds) for seconds in (600.0, 6000.0)]
    assert np.all(np.array(within) % 250 == 0)
    assert 250 <= within[0] < within[1]


def test_too_little_time_is_refused_with_the_least_that_is_enough(transitions: Transitions):
    with pytest.raises(ArgumentError, match=r"minutes: 6,000 transitions, the fewest .* need"):
        transitions_within(DATA, 1e-4)
    with pytest.raises(ArgumentError, match=r"minutes: no time is left for updates"):
        updates_within(transitions, SMALL, 0.0)


def test_a_stopped_run_goes_on_by_its_plan(dataset: Path, tmp_path: Path, cli: Cli):
    out = tmp_path / "e.emulator.safetensors"
    plan = run_folder(out) / "plan.json"
    plan.parent.mkdir()
    plan.write_text('{"updates":500}')
    line = ["train", dataset, "--out", out, "--widths", "8", "--batch", "16", "--minutes", "5"]
    done = cli(*line)
    assert done.returncode == 0, done.stderr
    assert "updates 500" in " ".join(done.stdout.split())
    plan.write_text('{"updates":-1}')
    refused = cli(*line)
    assert refused.returncode == 3
    assert f"{plan}: updates: wanted a whole number" in refused.stderr


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--minutes", "0"), "minutes: wanted more than 0"),
        (("--minutes", "2", "--updates", "500"), "minutes: they decide the number of updates"),
    ],
)
def test_minutes_that_cannot_be_are_refused(
    options: tuple[str, ...], told: str, dataset: Path, tmp_path: Path, cli: Cli
):
    refused = cli("train", dataset, "--out", tmp_path / "e.emulator.safetensors", *options)
    assert refused.returncode == 2
    assert told in refused.stderr
    assert list(tmp_path.iterdir()) == []


def test_data_of_another_system_are_not_gone_on_with(dataset: Path, tmp_path: Path, cli: Cli):
    copytree(dataset, tmp_path / "e.data")
    out = tmp_path / "e.emulator.safetensors"
    refused = cli("train", "pendulum-passive", "--out", out, "--minutes", "5")
    assert refused.returncode != 0
    assert "system" in refused.stderr
    assert not out.exists()
