"""Bounds of errors: of motions like those they were measured on so many stay below, whatever the scores are worth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import Emulator, NeuroAnimatorError, fit_error_bounds, fit_trust, load_system
from neuroanimator.emulator.c_emulator import facts_of_emulator
from neuroanimator.emulator.error_bounds import KINDS, LEVELS, USUAL_LEVEL, log_scores
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.files.zoo import LARGE, SHIPPED, emulator_name
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.bounded_errors import bounded_errors
from neuroanimator.learn.evaluation.held_out import held_out_runs
from neuroanimator.learn.training.error_fitting import (
    UnseenRuns,
    conformal_quantile,
    quantile_line,
    simulate_random,
    with_error_bounds,
)
from neuroanimator.learn.training.optimised_controls import optimised_controls

SYSTEM = load_system("pendulum")
SIGMAS = 4
"""Shares may be off by so many standard deviations of a binomial one."""


@pytest.fixture(scope="module")
def runs(shipped: Emulator) -> UnseenRuns:
    return simulate_random(shipped, SYSTEM, 800, seed=5)


@pytest.fixture(scope="module")
def bounded(shipped: Emulator, runs: UnseenRuns) -> Emulator:
    """The shipped pendulum with bounds measured on half of the runs."""
    half = UnseenRuns(runs.states[:400], runs.controls[:400])
    return with_error_bounds(shipped, SYSTEM.structure, half, [half])


def binomial(level: float, count: int) -> float:
    return SIGMAS * np.sqrt(level * (1 - level) / count)


@pytest.mark.parametrize("level", LEVELS)
def test_of_values_like_the_others_so_many_stay_below(level: float):
    rng = np.random.default_rng(1)
    below = []
    for _ in range(400):
        values = rng.standard_cauchy(100)
        bound = conformal_quantile(values[:-1], np.ones(99), level)
        below.append(values[-1] <= bound)
    assert np.mean(below) == pytest.approx(level, abs=0.01 + binomial(level, 400))


def test_values_count_by_their_share():
    values = np.r_[np.zeros(900), np.ones(100)]
    shares = np.r_[np.full(900, 1 / 900), np.full(100, 1 / 100)]
    assert conformal_quantile(values, shares, 0.45) == 0
    assert conformal_quantile(values, shares, 0.55) == 1


def test_a_line_has_the_share_below_it_at_both_ends():
    rng = np.random.default_rng(2)
    size = rng.normal(size=4000)
    error = 1 + 0.7 * size + (0.2 + 0.1 * np.abs(size)) * rng.normal(size=4000)
    line = quantile_line(size, error, np.ones(4000), 0.9)
    assert line[1] == pytest.approx(0.7, abs=0.1)
    is_below = error <= line[0] + line[1] * size
    for part in (size < 0, size > 0):
        assert is_below[part].mean() == pytest.approx(0.9, abs=binomial(0.9, int(part.sum())))


def test_scores_that_are_all_alike_or_mislead_leave_one_bound_for_all():
    error = np.random.default_rng(3).normal(size=1000)
    for size in (np.zeros(1000), -error):
        line = quantile_line(size, error, np.ones(1000), 0.8)
        assert line[1] == pytest.approx(0, abs=0.05)
        assert (error <= line[0]).mean() == pytest.approx(0.8, abs=0.02)


def test_unseen_motions_stay_below_at_every_level_and_horizon(bounded: Emulator, runs: UnseenRuns):
    states, controls = runs.states[400:], runs.controls[400:]
    assert bounded.calibration is not None
    emulated = bounded.rollout(states[:, 0], controls, may_diverge=True)
    errors = bounded.calibration.errors(SYSTEM.structure, states, emulated)[:, 1:]
    for level in LEVELS:
        is_below = errors <= bounded.error_bounds(states[:, 0], controls, level=level)
        # Both halves are drawn: their noise adds up.
        room = binomial(level, 200)
        for step in (0, 9, 19, 39):
            assert is_below[:, step].mean() == pytest.approx(level, abs=room)


def test_a_report_says_how_many_of_its_runs_stay_below(bounded: Emulator):
    test = held_out_runs(bounded, count=48, seconds=2.5, scheme=SYSTEM.truth)
    emulated = np.asarray(bounded.rollout(test.states[:, 0], test.controls), float)
    found = bounded_errors(bounded, test, emulated)
    assert found is not None
    assert found.covered.shape == found.bound.shape == (40,)
    assert found.covered.mean() == pytest.approx(found.level, abs=binomial(found.level, 48))
    assert str(found).endswith("after 2 s")
    assert bounded_errors(replace(bounded, calibration=None), test, emulated) is None


def test_bounds_grow_with_the_level_and_the_scores(bounded: Emulator):
    calibration = bounded.calibration
    assert calibration is not None
    scores = np.full((3, 40), [[0.1], [1.0], [5.0]])
    of_levels = [calibration.along(scores, level, "random") for level in LEVELS]
    assert (np.diff(np.stack(of_levels).mean(axis=2), axis=0) > 0).all()
    assert (np.diff(of_levels[2], axis=0) >= 0).all()
    assert np.isinf(calibration.along(np.ones(50), 0.9, "optimised")[40:]).all()
    assert np.isfinite(calibration.along(np.full(40, np.inf), 0.9, "random")).all()
    middle = np.exp(calibration.centre.astype(float)) - 0.01
    roots = np.sqrt(np.maximum(np.diff(np.r_[0, middle**2 * np.arange(1, 41)]), 0))
    if np.allclose(log_scores(roots), calibration.centre):
        np.testing.assert_allclose(
            calibration.along(roots, 0.9, "random"), calibration.usual(0.9, "random"), rtol=1e-3
        )


def test_a_file_keeps_the_bounds_and_its_programs_stay_the_same(
    shipped: Emulator, bounded: Emulator, runs: UnseenRuns, tmp_path: Path
):
    bounded.save(tmp_path / "bounded.safetensors")
    again = Emulator.load(tmp_path / "bounded.safetensors")
    pair = (runs.states[0, 0], runs.controls[0])
    np.testing.assert_array_equal(again.error_bounds(*pair), bounded.error_bounds(*pair))
    assert facts_of_emulator(again) == facts_of_emulator(replace(shipped, calibration=None))
    replace(shipped, calibration=None).save(tmp_path / "old.safetensors")
    old = Emulator.load(tmp_path / "old.safetensors")
    assert old.calibration is None
    with pytest.raises(NeuroAnimatorError, match="fit_error_bounds"):
        old.error_bounds(*pair)


def test_what_other_scores_or_super_steps_have_is_not_bounded(
    bounded: Emulator, transitions: Transitions
):
    assert fit_trust(bounded, transitions).calibration is None
    assert bounded.in_strides(2).calibration is None


def test_levels_kinds_and_numbers_of_runs_that_there_are_not_are_refused(
    shipped: Emulator, bounded: Emulator, runs: UnseenRuns
):
    pair = (runs.states[0, 0], runs.controls[0])
    with pytest.raises(NeuroAnimatorError, match=r"wanted one of 0\.5, 0\.8, 0\.9, 0\.95"):
        bounded.error_bounds(*pair, level=0.85)
    few = UnseenRuns(runs.states[:20], runs.controls[:20])
    with pytest.raises(NeuroAnimatorError, match="wanted at least 100 of each kind"):
        with_error_bounds(shipped, SYSTEM.structure, few)
    half = UnseenRuns(runs.states[:100], runs.controls[:100])
    alone = with_error_bounds(shipped, SYSTEM.structure, half)
    with pytest.raises(NeuroAnimatorError, match="random controls alone"):
        alone.error_bounds(*pair, are_optimised=True)


@pytest.mark.parametrize(
    "wrong",
    [
        {"kinds": 3},
        {"kinds": True},
        {"steps": 0},
        {"steps": 10**9},
        {"numbers": 0},
        {"numbers": 10**9},
        {"levels": []},
        {"levels": [0.9, 0.5]},
        {"levels": [0.0, 0.9]},
        {"levels": [0.9, 1.0]},
        {"levels": "0.9"},
    ],
)
def test_bounds_that_do_not_fit_are_refused(
    bounded: Emulator, tmp_path: Path, wrong: dict[str, object]
):
    path = tmp_path / "forged.safetensors"
    bounded.save(path)
    tensors, metadata = read_tensors(path, "emulator")
    metadata.pop("sha256", None)
    write_tensors(path, tensors, {**metadata, "errors": metadata["errors"] | wrong})
    with pytest.raises(NeuroAnimatorError):
        Emulator.load(path)


def test_exponents_that_nothing_comes_to_are_refused(bounded: Emulator, tmp_path: Path):
    path = tmp_path / "forged.safetensors"
    assert bounded.calibration is not None
    for field, factor in (("weights", 1e6), ("centre", 1e6), ("unit", -1)):
        value = factor * getattr(bounded.calibration, field)
        calibration = replace(bounded.calibration, **{field: value})
        replace(bounded, calibration=calibration).save(path)
        with pytest.raises(NeuroAnimatorError, match="not a usable emulator: errors"):
            Emulator.load(path)


def test_bounds_of_another_state_are_found_out(bounded: Emulator, runs: UnseenRuns):
    assert bounded.calibration is not None
    other = replace(bounded.calibration, unit=bounded.calibration.unit[:4])
    with pytest.raises(NeuroAnimatorError, match="of 4 numbers, its state changes by 6"):
        other.errors(SYSTEM.structure, runs.states, runs.states)


def test_descents_lead_where_random_controls_do_not_and_again_to_the_same_place(
    shipped: Emulator, runs: UnseenRuns
):
    starts, targets = runs.states[:64, 0], runs.states[:64, -1]
    controls = optimised_controls(shipped, starts, targets, 40, seed=0)
    assert shipped.bounds.contain(controls)
    _, found = shipped.rollout_trusted(starts, controls)
    _, usual = shipped.rollout_trusted(starts, runs.controls[:64])
    assert found.mean() > usual.mean()
    again = optimised_controls(shipped, starts, targets, 40, seed=0)
    np.testing.assert_array_equal(controls, again)


def test_fitting_simulates_both_kinds(shipped: Emulator):
    fitted = fit_error_bounds(shipped, random_runs=128, optimised_runs=128)
    assert fitted.calibration is not None
    assert len(fitted.calibration.weights) == len(KINDS)
    assert fitted.calibration.steps == 40


def test_every_emulator_that_ships_knows_its_bounds():
    shipped = [emulator_name(*row) for row in SHIPPED]
    large = [emulator_name(*row, "large") for row in LARGE]
    for name in (*shipped, *large):
        calibration = Emulator.load(name).calibration
        assert calibration is not None, name
        for kind in KINDS:
            bounds = calibration.along(np.ones(5), USUAL_LEVEL, kind)
            assert ((bounds > 0) & (bounds < np.inf)).all(), name
