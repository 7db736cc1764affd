"""What is told of an emulator's errors adds up, and a weak spot that is there is found."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from conftest import Cli

from neuroanimator import Emulator, load_system
from neuroanimator.learn.evaluation.component_errors import (
    by_relative_error,
    change_names,
    component_errors,
    error_spread,
)
from neuroanimator.learn.evaluation.held_out import HeldOut, held_out_runs
from neuroanimator.learn.evaluation.weakness import inspection
from neuroanimator.learn.evaluation.weakness.causes import find_weak_spots, outside_of_training
from neuroanimator.learn.evaluation.weakness.inspection import Inspection, inspect


@pytest.fixture(scope="module")
def found(shipped: Emulator) -> Inspection:
    return inspect(shipped, runs=24)


@pytest.fixture(scope="module")
def unseen(shipped: Emulator) -> HeldOut:
    system = load_system("pendulum")
    test = held_out_runs(shipped, count=48, seconds=2.0, scheme=system.truth)
    return replace(test, most_transitions=10_000)


def test_histograms_count_every_super_step(found: Inspection):
    errors = found.errors
    assert errors.counts.sum() == found.samples == 24 * 40
    assert 0 < errors.median < errors.high < errors.worst
    assert all(spread.counts.sum() == found.samples for spread in found.coverage.spreads)


def test_a_component_without_error_shows_zero_and_the_others_what_they_have(unseen: HeldOut):
    rng = np.random.default_rng(0)
    errors = rng.normal(size=(1000, 6)) * unseen.change_scale
    errors[:, 4] = 0
    components = component_errors(unseen, errors)
    assert [c.name for c in components][:2] == ["angle[0]", "angle[1]"]
    assert (components[4].error, components[4].worst, components[4].relative) == (0, 0, 0)
    for component in components[:4]:
        assert component.relative == pytest.approx(1, abs=0.1)
        assert component.error == pytest.approx(component.change, rel=0.1)
    assert by_relative_error(components)[-1] is components[4]


def test_what_never_moves_has_no_relative_error(unseen: HeldOut):
    still = replace(unseen, change_scale=np.where(np.arange(6) == 2, 0.0, unseen.change_scale))
    components = component_errors(still, np.ones((10, 6)))
    assert components[2].relative is None
    assert len(by_relative_error(components)) == 5


@pytest.mark.parametrize("name", ["pendulum", "lander", "truck", "fish"])
def test_every_number_of_a_change_has_a_name_and_a_unit(name: str, unseen: HeldOut):
    system = load_system(name)
    names = change_names(system)
    frame = replace(unseen, system=system).frame
    assert len(names) == frame.change_size(system.state.size)
    assert len(dict(names)) == len(names)
    assert "quaternion" not in dict(names).values()


def test_errors_of_no_finite_number_are_counted_as_the_worst():
    spread = error_spread(np.array([0.0, 0.1, 0.2, np.nan, np.inf]))
    assert spread.counts.sum() == 5
    assert spread.worst == np.inf
    nothing = error_spread(np.zeros(7))
    assert nothing.counts[0] == nothing.counts.sum() == 7
    assert nothing.worst == nothing.median == 0


def test_a_planted_weak_spot_is_found_with_what_is_most_wrong_there(unseen: HeldOut):
    rng = np.random.default_rng(1)
    steps = unseen.transitions
    relative = 0.01 * rng.normal(size=(len(steps.states), 6))
    is_planted = steps.states[:, 4] > np.quantile(steps.states[:, 4], 0.85)
    relative[is_planted, 3] *= 30
    spots = find_weak_spots(unseen, steps, relative, np.arange(len(relative)) // 40)
    assert spots[0].condition.startswith("velocity[1] > ")
    assert spots[0].condition.endswith(" rad/s")
    assert spots[0].component == "velocity[0]"
    assert spots[0].ratio > 4
    assert spots[0].share == pytest.approx(0.15, abs=0.08)
    assert "times that elsewhere where velocity[1] > " in str(spots[0])


def test_what_lies_beyond_training_is_counted_with_how_much_worse_it_is():
    is_covered = np.arange(100) % 4 > 0
    relative = np.where(is_covered, 1.0, 7.0)[:, None] * np.ones((1, 6))
    found = outside_of_training(is_covered, relative)
    assert (found.samples, found.share, found.ratio) == (25, 0.25, 7)
    assert "25 samples (25 % of all) lie outside the training data" in str(found)
    nowhere = outside_of_training(np.ones(100, bool), relative)
    assert (nowhere.samples, nowhere.share, nowhere.ratio) == (0, 0, 0)


def test_an_emulator_that_was_shown_little_is_outside_of_it_often(
    shipped: Emulator, found: Inspection
):
    domain = replace(shipped.domain, low=shipped.domain.low / 1e6, high=shipped.domain.high / 1e6)
    narrow = inspect(replace(shipped, domain=domain, meter=None), runs=4)
    assert found.outside.share < 0.05
    assert narrow.outside.share > 0.9
    assert narrow.weak_spots == ()


def test_an_error_that_is_the_same_everywhere_has_no_weak_spot(unseen: HeldOut):
    steps = unseen.transitions
    relative = 0.01 * np.random.default_rng(2).normal(size=(len(steps.states), 6))
    assert find_weak_spots(unseen, steps, relative, np.arange(len(relative)) // 40) == ()


def test_the_worst_segments_begin_alike_and_come_worst_first(found: Inspection, shipped: Emulator):
    assert len(found.worst) == 4
    assert len({segment.run for segment in found.worst}) == 4
    errors = [segment.error for segment in found.worst]
    assert errors == sorted(errors, reverse=True)
    for segment in found.worst:
        assert segment.physics.shape == segment.emulated.shape == (21, 6)
        np.testing.assert_allclose(segment.physics[0], segment.emulated[0], atol=1e-5)
        again = shipped.rollout(segment.physics[0], segment.controls)
        np.testing.assert_allclose(again, segment.emulated, atol=1e-4)
        assert segment.curves[0].name == segment.component
        assert [len(curve.physics) for curve in segment.curves] == [21, 21, 21]


def test_a_broken_emulator_is_inspected_too(shipped: Emulator):
    import equinox as eqx

    broken = eqx.tree_at(lambda e: e.network.out, shipped, replace_fn=lambda out: jnp.nan * out)
    found = inspect(broken, runs=4)
    assert found.errors.counts.sum() == found.samples
    assert found.worst[0].error >= 100


def test_info_tells_errors_of_an_emulator_and_of_nothing_else(
    dataset: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(inspection, "held_out_runs", partial(few_runs, inspection.held_out_runs))
    shown = cli("info", "pendulum-50", "--errors")
    assert shown.returncode == 0, shown.stderr
    assert "velocity[2] rad/s" in shown.stdout
    assert "in half of all super steps" in shown.stdout
    everything = json.loads(cli("info", "pendulum-50", "--errors", "--json").stdout)
    assert sum(everything["errors"]["counts"]) == everything["samples"]
    refused = cli("info", dataset, "--errors")
    assert refused.returncode == 2
    assert "errors: wanted an emulator, got the folder" in refused.stderr


def few_runs(held_out_runs: Callable[..., HeldOut], *arguments: Any, **options: Any) -> HeldOut:
    """Return the test that `held_out_runs` makes of only a few runs."""
    return held_out_runs(*arguments, **{**options, "count": 8})


def test_an_inspection_is_the_same_again_and_can_be_written_down(
    found: Inspection, shipped: Emulator
):
    again = inspect(shipped, runs=24)
    text = json.dumps(found.to_json(), sort_keys=True)
    assert text == json.dumps(again.to_json(), sort_keys=True)
    assert "physics" not in found.to_json()["worst"][0]
