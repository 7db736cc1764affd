"""Evaluations measure what they say."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import Emulator, evaluate, write_report
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.accuracy import one_step_error, scheme_error
from neuroanimator.learn.evaluation.baselines import baselines
from neuroanimator.learn.evaluation.evaluate import EvaluationBudget
from neuroanimator.learn.evaluation.held_out import held_out_runs
from neuroanimator.learn.evaluation.stability import count_diverged
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
