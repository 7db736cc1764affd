"""A dataset larger than memory: pools of windows in an order that follows from the seed, the same bytes after a kill."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from waiting import wait_until

from neuroanimator import (
    DatasetConfig,
    NeuroAnimatorError,
    TrainingConfig,
    generate,
    load_system,
    open_transitions,
    read_transitions,
    train,
)
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.learn.data.store import Dataset, Transitions, join_transitions
from neuroanimator.learn.data.stored import StoredTransitions, recut
from neuroanimator.learn.training.checkpoint import TrainingState
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK
from neuroanimator.learn.training.feed import Feed
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.learn.training.lesson import lesson_of
from neuroanimator.learn.training.optimizer import make_optimizer
from neuroanimator.learn.training.pools import Pools
from neuroanimator.learn.training.survey import Survey, sample_of, training_windows
from neuroanimator.learn.training.train import run_folder

TWO_SHARDS = 16_000_000
"""Memory in which a pool has two shards of the pendulum [bytes]."""


def small_config(**settings: object) -> TrainingConfig:
    """Return short training whose memory may be less than users may ask for: the data are small as well."""
    config = TrainingConfig(widths=(8, 8), updates=1500, batch=64)
    return config.model_copy(update={"memory": TWO_SHARDS, **settings})


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> StoredTransitions:
    """Five shards of the pendulum, the last of them half full."""
    folder = tmp_path_factory.mktemp("stored") / "pendulum"
    config = DatasetConfig(system="pendulum", substeps=5, count=41_000, samples_per_run=36)
    generate(config, folder, threads=1)
    return StoredTransitions(folder, config, load_system("pendulum"))


def pools_of(data: Dataset, config: TrainingConfig) -> Pools:
    return lesson_of(data, config, None).feed.pools


def rows(windows: np.ndarray) -> list[bytes]:
    """Return what tells each window from others."""
    return [window.tobytes() for window in np.ascontiguousarray(windows)]


def pool_rows(pools: Pools, first: int) -> Iterator[list[bytes]]:
    """Yield the windows of each pool from number `first` on."""
    for pool in pools.pools(first):
        yield rows(np.asarray(pool.states))


def training_rows(stored: StoredTransitions, config: TrainingConfig) -> list[bytes]:
    parts = [training_windows(stored, shard, config) for shard in range(stored.part_count)]
    return rows(join_transitions(parts).states)


def test_every_window_is_in_one_pool_of_every_epoch(stored: StoredTransitions):
    config = small_config()
    pools = pools_of(stored, config)
    assert 2 * pools.counts.max() <= pools.size < 3 * pools.counts.max()
    wanted = training_rows(stored, config)
    order: list[bytes] = []
    for pool in pool_rows(pools, 0):
        assert len(pool) == pools.size
        order += pool
        if len(order) >= 2 * pools.epoch:
            break
    first = order[: pools.epoch]
    second = order[pools.epoch : 2 * pools.epoch]
    assert Counter(first) == Counter(second) == Counter(wanted)
    assert first != second


def test_a_pool_has_windows_of_many_runs_however_small_it_is(stored: StoredTransitions):
    """Of few runs, windows are too much alike: errors of an emulator were a third larger."""
    pools = pools_of(stored, small_config())
    shards = [set(rows(training_windows(stored, shard, pools.config).states)) for shard in range(5)]
    for pool in islice(pool_rows(pools, 0), 3):
        of_shards = [len(shard.intersection(pool)) for shard in shards]
        assert all(of_shards)
        assert max(of_shards) < pools.size / 3


def test_the_order_follows_from_the_seed_alone(stored: StoredTransitions):
    first = next(pool_rows(pools_of(stored, small_config()), 0))
    assert next(pool_rows(pools_of(stored, small_config()), 0)) == first
    assert next(pool_rows(pools_of(stored, small_config(seed=1)), 0)) != first


def test_taken_up_anywhere_the_pools_go_on_as_if_they_had_never_stopped(
    stored: StoredTransitions,
):
    pools = pools_of(stored, small_config())
    whole = list(islice(pool_rows(pools, 0), 7))
    for number in (1, 2, 3, 6):
        assert next(pool_rows(pools, number)) == whole[number]


def test_a_pool_is_left_after_as_many_draws_as_it_has_windows(stored: StoredTransitions):
    config = small_config(updates=40_000)
    pools = pools_of(stored, config)
    draws = UPDATES_PER_CHUNK * config.batch
    assert pools.size > draws
    single = pools.of_chunks[: config.chunks // 2]
    assert single.tolist() == [chunk * draws // pools.size for chunk in range(len(single))]
    # Where a chunk draws more than a pool has, every chunk has a pool of its own and none is left out.
    greedy = replace(pools, config=small_config(updates=2000, batch=4096, unroll=1))
    assert greedy.of_chunks.tolist() == list(range(8))


def test_data_in_memory_are_one_pool_whatever_the_memory(stored: StoredTransitions, tmp_path: Path):
    whole = read_transitions(stored.folder)
    config = small_config(updates=250)
    pools = pools_of(whole, config)
    assert pools.is_one
    assert not pools.of_chunks.any()
    (pool,) = pool_rows(pools, 0)
    assert pool == rows(training_windows(whole, 0, config).states)
    files = [tmp_path / "small.safetensors", tmp_path / "large.safetensors"]
    for memory, file in zip((TWO_SHARDS, 10**9), files, strict=True):
        train(whole, small_config(updates=250, memory=memory), file)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_windows_are_cut_alike_wherever_parts_end(stored: StoredTransitions):
    whole = read_transitions(stored.folder)
    for size in (1000, 9216, 20_000, len(whole.states)):
        pieces = list(recut(stored.parts(), size))
        assert {len(piece.states) for piece in pieces[:-1]} <= {size}
        again = join_transitions(pieces)
        assert np.array_equal(again.states, whole.states)
        assert np.array_equal(again.run, whole.run)


def test_statistics_of_parts_are_those_of_the_whole(stored: StoredTransitions):
    config = small_config()
    whole = read_transitions(stored.folder)
    kept = np.isin(rows(whole.states), training_rows(stored, config))
    at_once = build_emulator(whole.where(kept), config)
    by_parts = build_emulator(sample_of(stored, config), config, Survey(stored, config).parts())
    for name in ("plain_mean", "plain_scale", "change_mean", "change_scale", "unit"):
        one = np.asarray(getattr(at_once.normaliser, name))
        other = np.asarray(getattr(by_parts.normaliser, name))
        np.testing.assert_allclose(other, one, rtol=1e-3, atol=1e-4)
    np.testing.assert_array_equal(np.asarray(by_parts.domain.low), np.asarray(at_once.domain.low))
    np.testing.assert_array_equal(np.asarray(by_parts.domain.high), np.asarray(at_once.domain.high))


TRAIN = """
import sys
from neuroanimator import DatasetConfig, TrainingConfig, load_system, train
from neuroanimator.learn.data.store import read_config
from neuroanimator.learn.data.stored import StoredTransitions
from pathlib import Path

folder = Path(sys.argv[1])
stored = StoredTransitions(folder, read_config(folder), load_system("pendulum"))
config = TrainingConfig(widths=(8, 8), updates=1500, batch=64)
train(stored, config.model_copy(update={"memory": int(sys.argv[3])}), sys.argv[2])
"""


@pytest.mark.endurance  # tests/learn/training/test_train.py kills a run; that pools go on as they were is above
def test_f02_killed_and_started_again_a_streamed_run_ends_with_the_same_bytes(
    stored: StoredTransitions, tmp_path: Path
):
    whole, broken = tmp_path / "whole.safetensors", tmp_path / "broken.safetensors"
    train(stored, small_config(), whole)
    command = [sys.executable, "-c", TRAIN, str(stored.folder), str(broken), str(TWO_SHARDS)]
    process = subprocess.Popen(command)
    metrics = run_folder(broken) / "metrics.jsonl"
    while process.poll() is None and not metrics.exists():
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    train(stored, small_config(), broken)
    assert broken.read_bytes() == whole.read_bytes()


MEASURE = """
import resource, sys
from pathlib import Path
from neuroanimator import TrainingConfig, load_system, train
from neuroanimator.learn.data.store import read_config
from neuroanimator.learn.data.stored import StoredTransitions, memory_taken

folder, out = Path(sys.argv[1]), Path(sys.argv[2])
system = load_system("pendulum")
one_shard = StoredTransitions(folder, read_config(folder), system)

class Repeated(StoredTransitions):
    # A large dataset whose shards are all the same real one.
    def read_part(self, number, unroll=4):
        return one_shard.read_part(0, unroll)

    fingerprint = "repeated"

config = TrainingConfig(widths=(8, 8), updates=1000, batch=256, memory=32_000_000)
count = int(sys.argv[3]) * one_shard.config.count
dataset = one_shard.config.model_copy(update={"count": count})
train(Repeated(folder, dataset, system), config, out)
peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(memory_taken(dataset, system) / config.memory, peak / config.memory)
"""


@pytest.mark.endurance
def test_resident_memory_is_bounded_by_the_limit_and_not_by_the_dataset(tmp_path: Path):
    folder = tmp_path / "one"
    config = DatasetConfig(system="pendulum", substeps=5, count=9216, samples_per_run=36)
    generate(config, folder, threads=1)
    processes = []
    for shards in (1, 50):
        out = tmp_path / f"{shards}.safetensors"
        command = [sys.executable, "-c", MEASURE, str(folder), str(out), str(shards)]
        processes.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
    printed = [process.communicate()[0].split() for process in processes]
    (_, small_peak), (times_the_limit, large_peak) = [map(float, line) for line in printed]
    assert times_the_limit > 10
    assert large_peak - small_peak < 1


def test_data_that_fit_are_read_and_others_stay_on_disk(stored: StoredTransitions):
    assert isinstance(open_transitions(stored.folder), Transitions)
    assert isinstance(open_transitions(stored.folder, TWO_SHARDS), StoredTransitions)


def test_memory_for_less_than_a_shard_is_refused(stored: StoredTransitions):
    with pytest.raises(NeuroAnimatorError, match=r"memory: 1MB holds no shard.*at least 8MB"):
        _ = pools_of(stored, small_config(memory=1_000_000)).size


def test_sizes_are_numbers_with_a_unit():
    assert TrainingConfig(memory="1.5GB").memory == 1_500_000_000
    for wrong in ("1gb", "GB", "much", "1MB"):
        with pytest.raises(NeuroAnimatorError, match="memory: "):
            TrainingConfig(memory=wrong)


def test_a_shard_that_changes_while_it_is_learnt_from_is_named(
    stored: StoredTransitions, tmp_path: Path
):
    for path in stored.folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    data = StoredTransitions(tmp_path, stored.config, stored.system)
    pools = pools_of(data, small_config())
    path = tmp_path / "shard-00003.safetensors"
    tensors, metadata = read_tensors(path, "shard")
    tensors = {**tensors, "states": tensors["states"] + 1}
    del metadata["sha256"]
    write_tensors(path, tensors, metadata)
    with pytest.raises(NeuroAnimatorError, match=r"shard-00003.safetensors has changed"):
        list(islice(pools.pools(0), 3))


def test_one_pool_is_made_ahead_and_errors_arrive(stored: StoredTransitions):
    made: list[int] = []

    class TwoPools(Pools):
        """Pools of which the third cannot be read, each of one chunk."""

        of_chunks = np.arange(6)

        def pools(self, first: int):
            for number, pool in enumerate(islice(super().pools(first), 2)):
                made.append(number)
                yield pool
            raise ValueError("no more")

    config = small_config()
    lesson = lesson_of(stored, config, None)
    pools = TwoPools(stored, lesson.problem.base, config, lesson.feed.pools.counts)
    network = lesson.problem.base.network
    state = TrainingState.fresh(network, make_optimizer(config)).optimizer_state
    with closing(Feed(lesson.problem, pools)) as feed:
        feed.train(network, state, 0)
        wait_until(lambda: made == [0, 1])
        feed.train(network, state, 1)
        with pytest.raises(ValueError, match="no more"):
            feed.train(network, state, 2)
    assert made == [0, 1]
