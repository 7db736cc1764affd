"""An emulator that no guess should lose to is judged in words; what never moves is no part of the judgement."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli

from neuroanimator import (
    DatasetConfig,
    Emulator,
    NeuroAnimatorError,
    evaluate,
    generate,
    load_emulator,
    read_transitions,
    train,
)
from neuroanimator.emulator.trust_summary import summary_of
from neuroanimator.emulator.verdict import WindowErrors, judge
from neuroanimator.files.zoo import shipped_emulators
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.baselines import CONSTANT_VELOCITY, NO_CHANGE
from neuroanimator.learn.evaluation.evaluate import EvaluationBudget
from neuroanimator.learn.evaluation.report import write_report
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.learn.training.survey import base_windows
from neuroanimator.learn.training.train import Report
from neuroanimator.learn.training.validation import validation_errors
from neuroanimator.physics.loading import resolve
from neuroanimator.scaffold.write_toml import write_definition

FAST = EvaluationBudget(runs=4, transitions=100, repeats=1, starts=20, steps=50, rounds=1)
TRAINING = {"updates": 500, "widths": (24, 24), "batch": 128}

REACHER = """\
<mujoco model="reacher">
  <option timestep="0.005" gravity="0 0 -9.81"/>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 0 1" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.5" contype="0" conaffinity="0"/>
    </body>
    TARGET
  </worldbody>
  <actuator><motor name="motor" joint="shoulder" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
TARGET = """\
    <body pos="0.3 0.3 0">
      <joint name="target_x" type="slide" axis="1 0 0" limited="true" range="-0.3 0.3"/>
      <joint name="target_y" type="slide" axis="0 1 0" limited="true" range="-0.3 0.3"/>
      <geom type="sphere" size="0.03" mass="1" contype="0" conaffinity="0"/>
    </body>
"""


def trained(folder: Path, model: str) -> tuple[Emulator, Transitions, TrainingConfig]:
    folder.mkdir()
    (folder / "reacher.xml").write_text(model)
    name, definition, substeps = resolve(str(write_definition(str(folder / "reacher.xml"))[0]))
    config = DatasetConfig(
        system=name, definition=definition, substeps=substeps, count=2412, samples_per_run=36
    )
    generate(config, folder / "data")
    data = read_transitions(folder / "data")
    return (
        train(data, TrainingConfig(**TRAINING), folder / "e.safetensors"),
        data,
        TrainingConfig(**TRAINING),
    )


@pytest.fixture(scope="module")
def with_target(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Emulator, Transitions, TrainingConfig]:
    return trained(tmp_path_factory.mktemp("with") / "m", REACHER.replace("TARGET", TARGET))


def test_what_never_moves_is_left_out_of_errors_and_diverged_rollouts(with_target):
    emulator, data, _ = with_target
    found = evaluate(emulator, data=data, budget=FAST)
    assert found.one_step_error < 0.2
    assert found.rollout_error_at(1.0) < 0.6
    assert found.diverged == 0
    assert [name.split("[")[0] for name in found.still] == [
        "target_x",
        "target_y",
        "target_x.velocity",
        "target_y.velocity",
    ]
    assert "Left out of all errors, since its change never varies: target_x[0] m" in found.note
    assert found.verdict.word in ("usable", "good")
    assert emulator.verdict is not None
    assert emulator.verdict.word in ("usable", "good")


@pytest.mark.parametrize(
    ("seconds", "error", "kept", "word"),
    [
        (1.0, 0.28, 0.4, "useless"),
        (0.5, 0.14, 0.4, "useless"),
        (1.0, 0.1, 0.09, "useless"),
        (1.0, 0.1, 0.4, "poor"),
        (1.0, 0.04, 0.07, "poor"),
        (1.0, 0.05, 0.4, "usable"),
        (0.5, 0.025, 0.4, "usable"),
        (2.0, 0.013, 0.4, "good"),
    ],
)
def test_a_soft_body_is_judged_by_where_its_nodes_are_after_a_while(
    seconds: float, error: float, kept: float, word: str
):
    window = WindowErrors(*(np.float32(number) for number in (seconds, error, kept)))
    good = judge(0.01, {NO_CHANGE: 1.0})
    verdict = window.judged(good)
    assert verdict.word == word
    assert f"its nodes are off by {error:.1%} of the body's size" in str(verdict)
    poor = judge(0.6, {NO_CHANGE: 1.0})
    assert (
        window.judged(poor).word == word
    )  # a step is off mostly by rates of wrinkles, which die out
    useless = judge(2.0, {NO_CHANGE: 1.0})
    assert window.judged(useless).word == "useless"


def test_what_never_moves_stands_still_whatever_the_network_says(with_target):
    emulator, _, _ = with_target
    start = np.array([0.5, 0.1, -0.2, 1.0, 0.0, 0.0], np.float32)
    path = np.asarray(emulator.rollout(start, np.ones((500, 1), np.float32)))
    np.testing.assert_array_equal(path[:, 1:3], np.tile(start[1:3], (501, 1)))
    np.testing.assert_array_equal(path[:, 4:], 0)
    assert np.ptp(path[:, 0]) > 0.1


def test_a_clock_goes_on_alike_and_adds_no_error(with_target):
    _, data, config = with_target
    states = data.states.copy()
    first = np.random.default_rng(0).uniform(-3, 3, (len(states), 1))
    states[..., 1] = first + 0.03 * np.arange(states.shape[1])
    fresh = build_emulator(replace(data, states=states), config)
    assert fresh.normaliser.unit[1] == 0
    assert fresh.normaliser.unit[0] > 0
    path = np.asarray(fresh.rollout(np.zeros(6), np.ones((50, 1))))
    np.testing.assert_allclose(path[:, 1], 0.03 * np.arange(51), atol=1e-5)


def test_what_stands_still_is_kept_within_the_range_of_training(with_target):
    emulator, _, _ = with_target
    drifting = emulator.normaliser.change_mean.at[4].set(0.1)
    wrong = replace(emulator, normaliser=replace(emulator.normaliser, change_mean=drifting))
    path = np.asarray(wrong.rollout(np.zeros(6), np.ones((500, 1))))
    low, high = (np.asarray(end) for end in wrong.domain.widened(0.1, slice(None)))
    entry = wrong.features.plain.index(4)
    assert path[:, 4].max() <= high[entry] + 1e-6
    assert path[:, 4].min() >= low[entry] - 1e-6


def test_a_useless_emulator_gets_no_speed_up(with_target, tmp_path: Path):
    emulator, data, _ = with_target
    scale = emulator.normaliser.change_scale
    wild = replace(emulator, normaliser=replace(emulator.normaliser, change_scale=20 * scale))
    found = evaluate(wild, data=data, budget=FAST)
    assert found.verdict.word == "useless"
    assert found.row()["equal_error_speedup"] == "none"
    assert found.equal_error_text == "none: it is worse than predicting no change"
    write_report([found], tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert "useless: it is worse than predicting no change" in text
    assert "at equal error the emulator" not in text


def test_the_error_that_training_reports_is_the_one_that_is_judged_and_stays_in_the_file(
    with_target, tmp_path: Path
):
    emulator, data, config = with_target
    path = tmp_path / "m.emulator.safetensors"
    reports: list[Report] = []
    train(data, config, path, on_report=reports.append)
    again = Emulator.load(path)
    assert again.validation is not None
    assert again.verdict is not None
    error = float(again.validation.emulator)
    assert error in [pytest.approx(report.error, rel=1e-3) for report in reports]
    assert str(again.verdict) == str(emulator.verdict)
    assert f"off by {error:.2g} of" in str(again.verdict)
    assert repr(again).endswith(f", {again.verdict.word})")


def test_what_is_useless_where_it_was_trained_is_called_so_wherever_its_trust_is_told(
    with_target, tmp_path: Path, cli: Cli
):
    emulator, data, _ = with_target
    scale = emulator.normaliser.change_scale
    wild = replace(emulator, normaliser=replace(emulator.normaliser, change_scale=20 * scale))
    windows = base_windows(wild, data)
    errors = validation_errors(wild, windows.states, windows.controls)
    path = tmp_path / "wild.emulator.safetensors"
    replace(wild, validation=errors).save(path)
    useless = "useless: it is worse than predicting no change"
    told = str(summary_of(Emulator.load(path), np.array([0.2, 0.3])))
    assert told.startswith("all of it within training")
    assert f"there the emulator is {useless}" in told
    for arguments in (
        ["info", path],
        ["animate", path, "--out", tmp_path / "m.csv", "--seconds", "1"],
    ):
        done = cli(*arguments)
        assert useless in done.stdout, done.stderr


def test_what_ships_is_good():
    for name in shipped_emulators():
        verdict = load_emulator(name).verdict
        assert verdict is not None
        assert verdict.word == "good", name


def test_a_file_that_tells_no_errors_says_so(with_target):
    emulator, _, _ = with_target
    silent = replace(emulator, validation=None)
    assert silent.verdict is None
    assert "the file does not say how good it is there" in str(summary_of(silent, np.zeros(2)))


@pytest.mark.parametrize("errors", [-1.0, np.inf, np.nan])
def test_errors_of_validation_that_are_none_are_refused(with_target, tmp_path: Path, errors: float):
    emulator, _, _ = with_target
    assert emulator.validation is not None
    forged = replace(emulator.validation, emulator=np.asarray(errors, np.float32))
    replace(emulator, validation=forged).save(tmp_path / "forged.safetensors")
    with pytest.raises(NeuroAnimatorError, match="validation"):
        Emulator.load(tmp_path / "forged.safetensors")


def test_a_model_in_which_nothing_moves_is_refused(tmp_path: Path):
    frozen = REACHER.replace("TARGET", "").replace(
        'axis="0 0 1" damping="0.05"', 'axis="0 0 1" damping="1e9"'
    )
    with pytest.raises(Exception, match="of its unit in a super step"):
        trained(tmp_path / "m", frozen)


CHEAP = {NO_CHANGE: 1.0, CONSTANT_VELOCITY: 0.8, "ridge regression": 0.01}


@pytest.mark.parametrize(
    ("error", "more", "word", "reason"),
    [
        (0.03, {}, "good", "one step is off by 0.03"),
        (0.03, {"diverged": 0, "rollouts": 1000}, "good", "0 of 1,000 long rollouts diverged"),
        (0.03, {"diverged": 5, "rollouts": 1000}, "usable", "5 of 1,000 long rollouts diverged"),
        (0.03, {"diverged": 472, "rollouts": 1000}, "poor", "472 of 1,000 long rollouts diverged"),
        (0.03, {"error_after_second": 1.3}, "usable", "after a second"),
        (0.03, {"error_after_second": math.nan}, "usable", "after a second"),
        (0.2, {}, "usable", "one step is off by 0.2"),
        (0.5, {}, "poor", "predicting that velocities stay as they are by no more than 0.8"),
        (
            0.9,
            {},
            "useless",
            "worse than predicting that velocities stay as they are (0.9 against 0.8",
        ),
        (
            2.39,
            {"diverged": 472, "rollouts": 1000},
            "useless",
            "worse than predicting no change (2.4 against 1",
        ),
        (math.nan, {}, "useless", "predictions are not even finite"),
        (math.inf, {}, "useless", "predictions are not even finite"),
    ],
)
def test_a_verdict_is_a_word_and_its_reason(
    error: float, more: dict[str, float], word: str, reason: str
):
    found = judge(error, CHEAP, **more)
    assert found.word == word
    assert reason in str(found)
