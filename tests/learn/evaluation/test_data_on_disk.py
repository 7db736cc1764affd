"""Figures of a dataset that stays on disk are those of one in memory, to the last bit, and no more than a shard lies there."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli

from neuroanimator import DatasetConfig, Emulator, NeuroAnimatorError, generate, read_transitions
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.data.stored import StoredTransitions, open_to_measure, super_steps
from neuroanimator.learn.evaluation.baselines import baselines
from neuroanimator.learn.evaluation.held_out import HeldOut, held_out_runs
from neuroanimator.learn.evaluation.weakness.coverage import coverage
from neuroanimator.learn.evaluation.weakness.inspection import inspect
from neuroanimator.learn.training.trust_fitting import fit_trust


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine shards of the pendulum, the last one smaller; in memory its windows take 12 MB."""
    folder = tmp_path_factory.mktemp("disk") / "pendulum"
    config = DatasetConfig(system="pendulum", substeps=5, count=80_000, samples_per_run=36)
    generate(config, folder, threads=1)
    return folder


@pytest.fixture(scope="module")
def stored(folder: Path) -> StoredTransitions:
    data = open_to_measure(folder)
    assert isinstance(data, StoredTransitions)
    assert data.config.shards == 9
    return data


@pytest.fixture(scope="module")
def read(folder: Path) -> Transitions:
    return read_transitions(folder)


@pytest.fixture(scope="module")
def unseen(shipped: Emulator) -> HeldOut:
    return held_out_runs(shipped, count=4, seconds=1.0)


def test_what_a_dataset_covers_is_the_same(stored: StoredTransitions, read: Transitions):
    found = coverage(stored).to_json()
    assert found == coverage(read).to_json()
    assert found["transitions"] > found["samples"] > 10_000


@pytest.fixture(scope="module")
def ridge(read: Transitions, unseen: HeldOut) -> dict[str, float]:
    """Errors of the baselines, of data in memory."""
    return baselines(read, unseen)


def test_ridge_regression_is_the_same(
    stored: StoredTransitions, unseen: HeldOut, ridge: dict[str, float]
):
    assert baselines(stored, unseen) == ridge


def test_ridge_regression_in_sums_is_that_of_all_rows_at_once(
    read: Transitions, unseen: HeldOut, ridge: dict[str, float]
):
    states, controls, _ = unseen.transitions

    def features(states: np.ndarray, controls: np.ndarray) -> np.ndarray:
        angles = states @ np.array(read.system.structure.angles, float).T
        plain = states[:, list(read.system.structure.plain)]
        local = unseen.frame.local(states)
        ones = np.ones((len(states), 1))
        columns = [np.sin(angles), np.cos(angles), plain, local, controls, ones]
        return np.concatenate(columns, axis=1)

    before, after = read.states[:, 0].astype(float), read.states[:, 1].astype(float)
    rows = features(before, read.controls[:, 0])
    penalty = np.sqrt(1e-6 * len(rows)) * np.eye(rows.shape[1])
    changes = unseen.frame.remainder(before, after)
    wanted = np.concatenate([changes, np.zeros((len(penalty), changes.shape[1]))])
    coefficients, *_ = np.linalg.lstsq(np.concatenate([rows, penalty]), wanted)
    guess = unseen.frame.apply(states, features(states, controls) @ coefficients)
    errors = unseen.relative(unseen.frame.difference(unseen.transitions.next_states, guess))
    expected = np.sqrt(np.mean(errors**2))
    assert ridge["ridge regression"] == pytest.approx(expected, rel=1e-6)


def test_what_an_old_file_is_told_it_knows_is_the_same(
    stored: StoredTransitions, read: Transitions, shipped: Emulator
):
    meters = [fit_trust(replace(shipped, meter=None), data).meter for data in (stored, read)]
    for name in ("odd", "even", "even_mean"):
        numbers, expected = (getattr(meter, name) for meter in meters)
        assert np.array_equal(numbers, expected)


def test_an_inspection_takes_either(
    stored: StoredTransitions, read: Transitions, shipped: Emulator
):
    found = [inspect(shipped, data=data, runs=8) for data in (stored, read)]
    assert found[0].coverage.to_json() == found[1].coverage.to_json()


@pytest.mark.parametrize(
    "measure",
    [
        lambda data, unseen: baselines(data, unseen),
        lambda data, unseen: coverage(data),
        lambda data, unseen: open_to_measure(data.folder),
    ],
)
def test_no_more_than_some_shards_lie_in_memory(
    measure: Callable[[StoredTransitions, HeldOut], object],
    stored: StoredTransitions,
    read: Transitions,
    unseen: HeldOut,
):
    measure(stored, unseen)  # what is imported and kept the first time is not what is measured
    # Other threads of this process are counted too, so the least of three is nearest to what it takes itself.
    least = min(peak_of(lambda: measure(stored, unseen)) for _ in range(3))
    assert least < 0.5 * read.states.nbytes


def peak_of(work: Callable[[], object]) -> int:
    """Return the most memory allocated at a time while `work` runs [bytes]."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_blocks_are_equally_long_wherever_shards_end(stored: StoredTransitions, read: Transitions):
    blocks = list(super_steps(stored))
    assert len({len(block.states) for block in blocks[:-1]}) == 1
    assert np.array_equal(np.concatenate([block.states for block in blocks]), read.states[:, 0])
    ends = np.concatenate([block.next_states for block in blocks])
    assert np.array_equal(ends, read.states[:, 1])


def test_a_damaged_shard_is_said_before_anything_is_measured(
    folder: Path, tmp_path: Path, cli: Cli
):
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    last = tmp_path / "shard-00008.safetensors"
    last.write_bytes(last.read_bytes()[:-4])
    with pytest.raises(NeuroAnimatorError, match="shard-00008"):
        open_to_measure(tmp_path)
    ended = cli("evaluate", "pendulum-50", "--data", tmp_path)
    assert (ended.returncode, ended.stdout) == (3, "")
    assert "shard-00008.safetensors is not a usable shard file" in ended.stderr
