"""What could not be read back is refused before it is trained: no training is lost."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from conftest import Cli

from neuroanimator import NeuroAnimatorError, TrainingConfig, load_system, train
from neuroanimator.emulator.networks import MAX_LAYER, check_widths
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training.train import run_folder
from neuroanimator.state.layout import Layout, Slice


def test_a_layer_wider_than_a_file_may_have_is_refused_before_any_work(cli: Cli, tmp_path: Path):
    result = cli(
        "train", "pendulum", "--widths", MAX_LAYER + 2, "--out", tmp_path / "e.safetensors"
    )
    assert result.returncode == 2
    assert (
        f"wanted at most {MAX_LAYER} units in a hidden layer, got {MAX_LAYER + 2}" in result.stderr
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("is_begun", [False, True])
def test_a_pipe_as_its_log_is_refused_and_not_waited_for(
    is_begun: bool, transitions: Transitions, tmp_path: Path
):
    out = tmp_path / "e.safetensors"
    log = run_folder(out) / "metrics.jsonl"
    if is_begun:
        train(transitions, TrainingConfig(updates=250, widths=(8,), batch=64), out)
        log.unlink()
    log.parent.mkdir(exist_ok=True)
    os.mkfifo(log)
    with pytest.raises(BadFileError, match="metrics.jsonl is not a file"):
        train(transitions, TrainingConfig(updates=250, widths=(8,), batch=64), out)


def test_the_widest_layer_that_is_read_may_be_trained():
    check_widths("gated", (MAX_LAYER, 1))
    assert TrainingConfig(widths=(MAX_LAYER,), network="classic").widths == (MAX_LAYER,)
    with pytest.raises(ArgumentError, match="at most 32 hidden layers"):
        TrainingConfig(widths=(8,) * 33)


def test_an_emulator_that_could_not_be_read_back_is_not_trained(
    transitions: Transitions, tmp_path: Path
):
    system = load_system("pendulum")
    system.state = Layout((Slice("angle", 3, "rad"), Slice("velocity, mean", 3, "rad/s")))
    unnamed = Transitions(
        transitions.config,
        system,
        transitions.states,
        transitions.controls,
        transitions.run,
        transitions.diverged,
    )
    settings = TrainingConfig(updates=10_000_000, widths=(8,))  # hours, were it begun
    with pytest.raises(
        NeuroAnimatorError,
        match="could not be read back .* state: wanted a name .*'velocity, mean'",
    ):
        train(unnamed, settings, tmp_path / "e.safetensors")
    assert not list(tmp_path.glob("**/*.safetensors"))
