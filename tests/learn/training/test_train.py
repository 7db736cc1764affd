"""Training learns, splits by run, and resumes to the same bytes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from conftest import Cli
from threadpoolctl import threadpool_info, threadpool_limits

from neuroanimator import Emulator, NeuroAnimatorError, TrainingConfig
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training import feed
from neuroanimator.learn.training.chunk import train_chunk
from neuroanimator.learn.training.survey import validation_mask
from neuroanimator.learn.training.train import SO_FAR, Report, read_metrics, run_folder, train

SMALL = ["--widths", "8", "--updates", "3000", "--batch", "16"]


def arguments(dataset: Path, out: Path) -> list[str]:
    return ["train", str(dataset), "--out", str(out), *SMALL]


def test_f02_killed_and_started_again_it_ends_with_the_same_bytes(
    dataset: Path, tmp_path: Path, cli: Cli
):
    whole, broken = tmp_path / "whole.safetensors", tmp_path / "broken.safetensors"
    assert cli(*arguments(dataset, whole)).returncode == 0
    metrics = run_folder(broken) / "metrics.jsonl"
    program = [sys.executable, "-c", "from neuroanimator.cli.main import main; main()"]
    process = subprocess.Popen([*program, *arguments(dataset, broken)], stdout=subprocess.DEVNULL)
    while process.poll() is None and not metrics.exists():
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert cli(*arguments(dataset, broken)).returncode == 0
    assert broken.read_bytes() == whole.read_bytes()
    checkpoints = [
        (run_folder(out) / "checkpoint.safetensors").read_bytes() for out in (whole, broken)
    ]
    assert checkpoints[0] == checkpoints[1]
    logs = [
        [json.loads(line) for line in (run_folder(out) / "metrics.jsonl").read_text().splitlines()]
        for out in (whole, broken)
    ]
    assert [{**line, "seconds": 0} for line in logs[0]] == [
        {**line, "seconds": 0} for line in logs[1]
    ]


@pytest.mark.parametrize(
    ("settings", "least_error"),
    [
        ({"network": "gated", "widths": (24, 24)}, 0.2),
        ({"network": "gated", "widths": (24, 24), "optimizer": "adam"}, 0.25),
        ({"network": "classic", "optimizer": "momentum"}, 0.6),
    ],
)
def test_each_network_and_optimiser_learns(
    settings, least_error, transitions: Transitions, tmp_path: Path
):
    reports: list[Report] = []
    config = TrainingConfig(updates=2000, batch=128, **settings)
    train(transitions, config, tmp_path / "e.safetensors", on_report=reports.append)
    assert read_metrics(run_folder(tmp_path / "e.safetensors") / "metrics.jsonl") == reports
    assert reports[-1].error < least_error
    assert reports[-1].error < reports[0].error


def test_validation_runs_are_whole_and_unseen(transitions: Transitions):
    held_out = validation_mask(transitions.run, TrainingConfig())
    assert 0 < held_out.mean() < 0.2
    assert not set(transitions.run[held_out]) & set(transitions.run[~held_out])


def test_early_stopping_stops(transitions: Transitions, tmp_path: Path):
    config = TrainingConfig(
        updates=100_000,
        batch=64,
        patience=1,
        learning_rate=1.0,
        optimizer="momentum",
        widths=(8,),
        network="classic",
    )
    reports: list[Report] = []
    train(transitions, config, tmp_path / "e.safetensors", on_report=reports.append)
    assert reports[-1].update < 100_000


def test_a_training_shows_its_best_so_far(transitions: Transitions, tmp_path: Path):
    out = tmp_path / "e.safetensors"
    so_far = run_folder(out) / SO_FAR
    moved = []

    def look(report: Report) -> None:
        emulator = Emulator.load(so_far)
        controls = np.ones((3, emulator.control.size))
        moved.append(emulator.rollout(emulator.rest, controls)[-1])

    config = TrainingConfig(widths=(8,), updates=3000, batch=16)
    train(transitions, config, out, on_report=look)
    assert np.isfinite(moved).all()
    assert np.any(moved[0] != moved[1])
    assert not so_far.exists()


def test_updates_have_one_thread_of_blas(
    transitions: Transitions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    threads = set()

    def look(*arguments):
        pools = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
        threads.update(pool["num_threads"] for pool in pools)
        return train_chunk(*arguments)

    monkeypatch.setattr(feed, "train_chunk", look)
    with threadpool_limits(2, "blas"):
        config = TrainingConfig(widths=(8,), updates=250, batch=16, unroll=1)
        train(transitions, config, tmp_path / "e.safetensors")
    assert threads == {1}


def test_a_run_with_other_settings_is_refused_and_untouched(
    transitions: Transitions, tmp_path: Path
):
    out = tmp_path / "e.safetensors"
    config = TrainingConfig(widths=(8, 8), updates=1000, batch=16)
    train(transitions, config, out)
    before = out.read_bytes()
    with pytest.raises(NeuroAnimatorError, match="other data or settings"):
        train(transitions, config.model_copy(update={"seed": 1}), out)
    assert out.read_bytes() == before


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("updates", 0),
        ("batch", 1),
        ("unroll", 17),
        ("learning_rate", float("nan")),
        ("network", "deep"),
        ("x", 1),
    ],
)
def test_bad_settings_are_refused_by_field(field: str, value: object):
    with pytest.raises(NeuroAnimatorError, match=field):
        TrainingConfig(**{field: value})


def test_a_dataset_too_small_to_split_is_refused(transitions: Transitions, tmp_path: Path):
    one_run = transitions.where(transitions.run == transitions.run[0])
    with pytest.raises(NeuroAnimatorError, match="too few"):
        train(one_run, TrainingConfig(), tmp_path / "e.safetensors")


def test_f06_two_trainings_cannot_share_a_folder(transitions: Transitions, tmp_path: Path):
    from neuroanimator.files.atomic import locked

    out = tmp_path / "e.safetensors"
    with locked(run_folder(out)), pytest.raises(NeuroAnimatorError, match="in use by process"):
        train(transitions, TrainingConfig(), out)
    assert not out.exists()
    assert np.isfinite(transitions.states).all()


def test_trainings_of_one_kind_compile_once(
    transitions: Transitions, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    fewer = transitions.where(transitions.run < transitions.run.max())
    runs = [(transitions, 250, 0), (transitions, 500, 1), (fewer, 250, 2)]
    with jax.log_compiles():
        for number, (data, updates, seed) in enumerate(runs):
            config = TrainingConfig(widths=(6,), updates=updates, seed=seed, batch=8, unroll=1)
            train(data, config, tmp_path / f"{number}.safetensors")
    compiled = [line for line in caplog.messages if "train_chunk" in line and "Compiling" in line]
    assert len(compiled) == 1
