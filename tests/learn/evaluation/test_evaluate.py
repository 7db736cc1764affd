"""Evaluations measure what they say."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from brief import BRIEF
from conftest import Cli
from matplotlib.figure import Figure

from neuroanimator import Emulator, load_emulator, write_report
from neuroanimator.files.zoo import find_emulator
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.accuracy import error_after, one_step_error, scheme_error
from neuroanimator.learn.evaluation.baselines import baselines
from neuroanimator.learn.evaluation.evaluate import EvaluationBudget, evaluate
from neuroanimator.learn.evaluation.figures import draw_training
from neuroanimator.learn.evaluation.held_out import held_out_runs
from neuroanimator.learn.evaluation.model_card import write_card
from neuroanimator.learn.evaluation.page import as_markdown
from neuroanimator.learn.evaluation.report import training_html
from neuroanimator.learn.evaluation.stability import count_diverged
from neuroanimator.learn.evaluation.trust_bands import SHARES, trust_bands
from neuroanimator.learn.training.train import Report, read_metrics, run_folder
from neuroanimator.physics.rigid.mujoco_system import INTEGRATORS
from neuroanimator.systems.system import Scheme


def test_the_reference_has_no_error_against_itself_and_coarser_steps_have_more(shipped: Emulator):
    test = held_out_runs(shipped, count=8, seconds=0.5)
    errors = [scheme_error(test, Scheme("euler", dt)) for dt in (0.001, 0.005, 0.025)]
    assert scheme_error(test, test.system.fine) == 0
    assert scheme_error(test, test.system.truth) < 1e-3
    assert errors[0] < errors[1] < errors[2]


def test_the_shipped_emulator_beats_every_cheap_predictor(
    shipped: Emulator, transitions: Transitions
):
    test = held_out_runs(shipped, count=8)
    error = np.sqrt(np.mean(one_step_error(shipped, test) ** 2))
    cheap = baselines(transitions, test)
    assert error < 0.02
    assert set(cheap) == {"persistence", "constant velocity", "ridge regression"}
    assert error < 0.2 * min(cheap.values())


def test_no_rollout_of_the_shipped_emulator_diverges(shipped: Emulator):
    assert count_diverged(shipped, starts=200, steps=1000) == 0


def test_a_broken_emulator_is_found_to_diverge(shipped: Emulator):
    import equinox as eqx

    broken = eqx.tree_at(lambda e: e.network.out, shipped, replace_fn=lambda out: jnp.nan * out)
    assert count_diverged(broken, starts=20, steps=200) == 20


def test_a_wild_emulator_is_kept_where_training_was(shipped: Emulator):
    import equinox as eqx

    wild = eqx.tree_at(lambda e: e.network.out, shipped, replace_fn=lambda out: 500 * out)
    assert count_diverged(wild, starts=20, steps=200) == 0


def test_an_evaluation_is_complete_and_its_report_stands_alone(
    shipped: Emulator, transitions: Transitions, tmp_path: Path
):
    found = evaluate(
        shipped,
        data=transitions,
        budget=EvaluationBudget(
            runs=4, transitions=160, repeats=1, starts=10, steps=50, rounds=1, hybrid_runs=2
        ),
    )
    row = found.row()
    # A hundred and more on an idle machine; here nothing is optimised, and others use the cores.
    assert row["nominal_speedup"] > 5
    assert found.speed.equal_error_opponent.error <= found.one_step_error
    # What no physics matches, as of shapes that nodes are put together of, is at equal error with none.
    matchless = replace(found, error_by_entry=1e-9 * found.error_by_entry)
    assert found.row()["equal_error_speedup"] == found.speed.equal_error
    assert matchless.row()["equal_error_speedup"] == "none"
    assert matchless.equal_error_text.startswith("none: no physics")
    assert {o.scheme.integrator for o in found.speed.opponents} == set(INTEGRATORS)
    assert found.rollout_errors[0] == pytest.approx(0, abs=1e-6)
    assert found.rollout_error_at(1.0) > found.rollout_error_at(0.1)
    write_report([found], tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg class=plot") == 6 + (found.bounded is not None)
    assert ("Errors of rollouts and their bounds" in page) == (found.bounded is not None)
    assert "In turns with the physics" in page
    assert page.count("<svg class=bars") == 9
    assert found.inspection is not None
    for spread in found.inspection.coverage.spreads:
        assert spread.counts.sum() == 6000
    assert found.weak_spots == found.inspection.weak_spots
    for figure in row:
        assert f"<dt>{figure.replace('_', ' ')}</dt>" in page
    assert not re.search(r'(src|href)="https?://', page.replace('xlink:href="#', ""))


@pytest.mark.parametrize(("seconds", "error"), [(0.0, 1), (0.2, 2), (0.34, 3), (9.0, 4)])
def test_an_error_is_that_of_the_nearest_super_step_but_the_start(seconds: float, error: float):
    assert error_after(np.arange(5.0), 0.1, seconds) == error


def test_bands_go_up():
    rng = np.random.default_rng(2)
    scores = rng.exponential(size=1000)
    errors = scores * rng.uniform(0.9, 1.1, 1000)
    bands = trust_bands(scores, errors)
    assert len(bands) == len(SHARES) - 1
    for lower, higher in itertools.pairwise(bands):
        assert lower.middle < higher.middle
        assert lower.median < higher.median
        assert lower.median <= lower.large


def test_scores_that_say_nothing_make_no_bands():
    errors = np.linspace(0, 1, 100)
    assert trust_bands(np.zeros(100), errors) == ()
    assert trust_bands(np.full(100, np.inf), errors) == ()
    assert trust_bands(np.zeros(0), np.zeros(0)) == ()
    assert trust_bands(np.arange(100.0), np.where(errors > 0.5, np.nan, errors))[-1].large < 0.5


def test_a_card_says_what_it_is_and_what_was_measured(tmp_path: Path):
    file = find_emulator("pendulum-100")
    emulator = load_emulator(file)
    write_card(emulator, file, evaluate(emulator, budget=BRIEF), tmp_path / "card.md")
    card = (tmp_path / "card.md").read_text()
    head, _, body = card.removeprefix("---\n").partition("\n---\n")
    assert "license: apache-2.0" in head.splitlines()
    assert body.lstrip().startswith("# pendulum, n = 100\n")
    titles = [line for line in body.splitlines() if line.startswith("## ")]
    assert titles == [
        "## How it was made", "## How far to trust it", "## State", "## Control", "## Use it",
    ]  # fmt: skip
    assert "| equal error speedup |" in body
    assert "| N·m |" in body.partition("## Control")[2]


def test_one_card_is_of_one_emulator(cli: Cli, tmp_path: Path):
    told = cli("evaluate", "pendulum", "fish", "--card", str(tmp_path / "card.md"))
    assert told.returncode == 2
    assert "evaluate --card: wanted one emulator, got 2." in told.stderr
    assert not (tmp_path / "card.md").exists()


@pytest.mark.attack
def test_a_strangers_words_are_no_markup():
    shown = str(as_markdown("a|b\n# c <script>alert(1)</script> ![x](http://y) `rm` \x1b[2J"))
    assert "\n" not in shown
    assert "\x1b" not in shown
    for sign in "|#<>[]`!":
        assert sign not in shown.replace(f"\\{sign}", "")


def test_the_curve_of_a_training_is_what_it_reported(tmp_path: Path):
    out = tmp_path / "small.emulator.safetensors"
    reports = [
        Report(
            update=500 * number,
            loss=1 / number,
            error=2 / number,
            unrolled_error=3 / number,
            seconds=0.1,
        )
        for number in range(1, 4)
    ]
    run_folder(out).mkdir()
    metrics = run_folder(out) / "metrics.jsonl"
    lines = [json.dumps(report._asdict()) for report in reports]
    metrics.write_text("\n".join([*lines, '{"update": 17, "loss"']))  # the last one is torn
    assert read_metrics(metrics) == reports
    axes = Figure().add_subplot()
    draw_training(axes, reports)
    updates, errors = axes.lines[0].get_data()
    assert list(updates) == [500, 1000, 1500]
    assert list(errors) == [2, 1, 2 / 3]
    assert "<p>1,500 updates." in training_html(out)
    assert training_html(out).count("<svg class=plot") == 1


def test_an_emulator_that_came_alone_has_no_curve_and_says_so(tmp_path: Path):
    told = training_html(tmp_path / "<b>.safetensors")
    assert told.startswith("<p>No curve: &lt;b&gt;.run/metrics.jsonl does not lie beside")
