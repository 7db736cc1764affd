"""What a dataset covers is counted as it is, and what is said to be larger somewhere is larger there."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli

from neuroanimator import NeuroAnimatorError, coverage, load_system
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.weakness.conditions import find_spots
from neuroanimator.learn.evaluation.weakness.coverage import Spread
from neuroanimator.learn.evaluation.weakness.readings import Reading, state_readings
from neuroanimator.state.rotation import facing, multiply


def test_histograms_count_every_sample_and_quantiles_are_in_order(transitions: Transitions):
    found = coverage(transitions)
    assert found.samples == found.transitions == len(transitions.states)
    assert [spread.name for spread in found.controls] == ["torque[0]", "torque[1]", "torque[2]"]
    for spread in found.spreads:
        assert spread.counts.sum() == found.samples
        assert len(spread.edges) == len(spread.counts) + 1
        quantiles = [spread.least, spread.low, spread.median, spread.high, spread.most]
        assert quantiles == sorted(quantiles)


def test_the_folder_covers_what_its_transitions_do(dataset: Path, transitions: Transitions):
    from_folder = coverage(dataset)
    in_memory = coverage(transitions)
    assert from_folder.runs == in_memory.runs == 500
    assert [s.counts.tolist() for s in from_folder.spreads] == [
        s.counts.tolist() for s in in_memory.spreads
    ]


def test_controls_at_their_bounds_are_counted(transitions: Transitions):
    bounds = transitions.system.bounds
    controls = np.array(transitions.controls)
    controls[:, :, 0] = bounds.high[0]
    controls[:, :, 1] = bounds.middle[1]
    controls[::2, :, 2] = bounds.low[2]
    controls[1::2, :, 2] = bounds.middle[2]
    found = coverage(replace(transitions, controls=controls))
    assert [spread.at_bounds for spread in found.controls] == [1, 0, 0.5]
    assert found.states[0].at_bounds is None


def test_whole_numbers_get_a_bar_each_and_a_constant_has_one_bar():
    spread = Spread.of(Reading("contacts", "1", np.array([0.0, 0, 2, 2, 2, 3])))
    assert spread.counts.tolist() == [2, 0, 3, 1]
    constant = Spread.of(Reading("x", "m", np.full(7, 0.25)))
    assert constant.counts.max() == constant.counts.sum() == 7


@pytest.mark.parametrize("name", ["lander", "fish"])
def test_moving_and_turning_the_world_changes_no_reading_that_matters(name: str):
    system = load_system(name)
    states = system.sample_starts(np.random.default_rng(0), 20)
    turn = facing(np.array(1.0))
    moved = np.array(states)
    if system.structure.cloud is None:
        moved[:, :3] += [3, -4, 0]
        moved[:, 3:7] = multiply(turn, states[:, 3:7])
        vectors = [slice(7, 10)]
    else:
        size = 3 * system.structure.cloud.count
        vectors = [slice(i, i + 3) for i in range(0, 2 * size, 3)]
    rotation = np.array([[np.cos(1), -np.sin(1), 0], [np.sin(1), np.cos(1), 0], [0, 0, 1]])
    for vector in vectors:
        moved[:, vector] = states[:, vector] @ rotation.T
    pairs = zip(state_readings(system, states), state_readings(system, moved), strict=True)
    mattering = [(here, there) for here, there in pairs if here.can_matter]
    assert len(mattering) >= 7
    for here, there in mattering:
        np.testing.assert_allclose(here.values, there.values, atol=1e-6, err_msg=here.name)


def samples(rng: np.random.Generator) -> tuple[list[Reading], np.ndarray, np.ndarray]:
    """Return readings of 64 runs of 40 samples, the runs, and errors that depend on nothing."""
    drawn = rng.normal(size=(3, 64 * 40))
    names = ("height", "speed", "spin")
    readings = [Reading(name, "m/s", values) for name, values in zip(names, drawn, strict=True)]
    return readings, np.repeat(np.arange(64), 40), np.exp(rng.normal(size=64 * 40))


@pytest.mark.parametrize("seed", range(5))
def test_a_planted_spot_is_found_and_measured(seed: int):
    readings, runs, errors = samples(np.random.default_rng(seed))
    is_planted = np.abs(readings[1].values) > 1.5
    [(spot, holds)] = find_spots(np.where(is_planted, 8 * errors, errors), runs, readings)
    assert spot.condition.startswith("|speed| > 1.")
    assert spot.condition.endswith(" m/s")
    assert spot.share == pytest.approx(is_planted.mean(), abs=0.05)
    assert 4 < spot.ratio < 12
    assert (holds & is_planted).sum() > 0.9 * is_planted.sum()


def test_nothing_is_found_where_nothing_is():
    for seed in range(20):
        readings, runs, errors = samples(np.random.default_rng(seed))
        assert find_spots(errors, runs, readings) == []


def test_what_cannot_matter_is_no_condition_and_no_error_has_no_spot():
    readings, runs, errors = samples(np.random.default_rng(1))
    is_planted = readings[0].values > 1
    unseen = [readings[0]._replace(can_matter=False), *readings[1:]]
    assert find_spots(np.where(is_planted, 5 * errors, errors), runs, unseen) == []
    assert find_spots(np.zeros(len(runs)), runs, readings) == []


def test_a_half_generated_folder_says_what_is_missing(dataset: Path, cli: Cli, tmp_path: Path):
    folder = tmp_path / "half"
    shutil.copytree(dataset, folder)
    (folder / "shard-00001.safetensors").unlink()
    found = coverage(folder)
    assert found.missing == ("shard-00001.safetensors",)
    assert found.transitions == found.samples == 256 * 12
    shown = cli("info", folder)
    assert shown.returncode == 0, shown.stderr
    assert "run the same 'generate' again" in shown.stdout
    (folder / "shard-00000.safetensors").write_bytes(b"torn")
    with pytest.raises(NeuroAnimatorError, match="holds no complete shard yet"):
        coverage(folder)
    (folder / "shard-00000.safetensors").unlink()
    assert "0 of 2 made" in cli("info", folder).stdout


def test_a_folder_that_is_no_dataset_is_refused_in_one_line(cli: Cli, tmp_path: Path):
    refused = cli("info", tmp_path)
    assert refused.returncode == 3
    assert "is not a dataset: no dataset.json" in refused.stderr
    assert refused.stderr.count("\n") == 1


def test_info_shows_a_line_for_every_number(dataset: Path, cli: Cli):
    shown = cli("info", dataset).stdout
    for name in ("angle[2] rad", "velocity[0] rad/s", "torque[1] N·m"):
        assert name in shown
    assert "at a bound" in shown
    assert "█" in shown
    everything = json.loads(cli("info", dataset, "--json").stdout)
    assert sum(everything["coverage"]["states"][0]["counts"]) == 6000
