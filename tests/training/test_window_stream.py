"""A dataset larger than memory: every window once an epoch, an order that follows from the seed, the same bytes after a kill."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections import Counter
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

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
from neuroanimator.data.store import Transitions
from neuroanimator.data.stored import StoredTransitions
from neuroanimator.training.config import UPDATES_PER_CHUNK
from neuroanimator.training.feed import StreamFeed
from neuroanimator.training.initialise import build_emulator
from neuroanimator.training.lesson import lesson_of
from neuroanimator.training.prefetch import Prefetched
from neuroanimator.training.survey import Survey, sample_of, training_runs
from neuroanimator.training.train import run_folder
from neuroanimator.training.window_stream import WindowStream

TWO_SHARDS = 4_000_000
"""Memory in which a pool has two shards of the pendulum [bytes]."""


def small_config(**settings: object) -> TrainingConfig:
    """Return short training whose memory is less than users may ask for: the data are small as well."""
    config = TrainingConfig(widths=(8, 8), updates=1500, batch=64)
    return config.model_copy(update={"memory": TWO_SHARDS, **settings})


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> StoredTransitions:
    """Five shards of the pendulum, the last of them half full."""
    folder = tmp_path_factory.mktemp("stored") / "pendulum"
    config = DatasetConfig(system="pendulum", substeps=5, count=41_000, samples_per_run=36)
    generate(config, folder, threads=1)
    return StoredTransitions(folder, config, load_system("pendulum"))


def stream_of(stored: StoredTransitions, config: TrainingConfig) -> WindowStream:
    feed = lesson_of(stored, config, None).feed
    assert isinstance(feed, StreamFeed)
    return feed.stream


def rows(windows: np.ndarray) -> list[bytes]:
    """Return what tells each window from others."""
    return [window.tobytes() for window in np.ascontiguousarray(windows)]


def stream_rows(stream: WindowStream, position: int, count: int) -> list[bytes]:
    """Return the states at which `count` windows begin, from number `position` of the stream on."""
    found: list[bytes] = []
    for pool in stream.pools(position):
        found += rows(pool.numbers[pool.begins[pool.skipped :], :6])
        if len(found) >= count:
            return found[:count]
    raise AssertionError("the stream has ended")


def training_rows(stored: StoredTransitions, config: TrainingConfig) -> list[bytes]:
    found: list[bytes] = []
    for shard in range(stored.config.shards):
        runs = training_runs(stored.read(shard).runs, config, shard)
        found += rows(runs.windows(1)[0][:, 0])
    return found


def test_every_window_is_seen_once_in_every_epoch(stored: StoredTransitions):
    config = small_config()
    stream = stream_of(stored, config)
    assert stream.shards_per_pool == 2
    wanted = Counter(training_rows(stored, config))
    for epoch in range(2):
        assert Counter(stream_rows(stream, epoch * stream.epoch, stream.epoch)) == wanted


def test_the_order_follows_from_the_seed_alone(stored: StoredTransitions):
    count = 30_000
    stream = stream_of(stored, small_config())
    order = stream_rows(stream, 0, count)
    assert stream_rows(stream_of(stored, small_config()), 0, count) == order
    assert stream_rows(stream_of(stored, small_config(seed=1)), 0, count) != order
    assert stream_rows(stream, stream.epoch, count) != order


def test_taken_up_anywhere_a_stream_goes_on_as_if_it_had_never_stopped(stored: StoredTransitions):
    stream = stream_of(stored, small_config())
    whole = stream_rows(stream, 0, 2 * stream.epoch)
    for position in (1, 9_000, stream.epoch - 1, stream.epoch, stream.epoch + 17_000):
        assert stream_rows(stream, position, 500) == whole[position : position + 500]


@pytest.mark.parametrize("rare_share", [0.0, 0.25])
def test_blocks_are_the_stream_in_batches(stored: StoredTransitions, rare_share: float):
    config = small_config(rare_share=rare_share)
    feed = lesson_of(stored, config, None).feed
    assert isinstance(feed, StreamFeed)
    stream = feed.stream
    demands = list(feed.demands_of(0))
    assert sum(demand.updates for demand in demands) == UPDATES_PER_CHUNK
    blocks = list(stream.blocks(iter(demands), 0))
    new = stream.new_per_batch(config.batch)
    states = np.concatenate([block.windows[:, :new, 0, :6].reshape(-1, 6) for block in blocks])
    assert rows(states) == stream_rows(stream, 0, UPDATES_PER_CHUNK * new)
    if rare_share:
        # Importance sampling: windows drawn more often count less, and the mean weight stays one.
        weights = np.concatenate([block.weights for block in blocks])
        assert weights.mean() == pytest.approx(1, abs=0.02)
        assert (weights[:, new:] < 1).all()


def test_statistics_of_parts_are_those_of_the_whole(stored: StoredTransitions):
    config = small_config()
    whole = read_transitions(stored.folder)
    kept = np.isin(rows(whole.states[:, 0]), training_rows(stored, config))
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
from neuroanimator.data.store import read_config
from neuroanimator.data.stored import StoredTransitions
from pathlib import Path

folder = Path(sys.argv[1])
stored = StoredTransitions(folder, read_config(folder), load_system("pendulum"))
config = TrainingConfig(widths=(8, 8), updates=1500, batch=64)
train(stored, config.model_copy(update={"memory": int(sys.argv[3])}), sys.argv[2])
"""


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
from neuroanimator.data.store import read_config
from neuroanimator.data.stored import StoredTransitions, memory_taken

folder, out = Path(sys.argv[1]), Path(sys.argv[2])
system = load_system("pendulum")
one_shard = StoredTransitions(folder, read_config(folder), system)

class Repeated(StoredTransitions):
    # A large dataset whose shards are all the same real one.
    def read(self, shard):
        return one_shard.read(0)

config = TrainingConfig(widths=(8, 8), updates=1000, batch=256, memory=32_000_000)
count = int(sys.argv[3]) * one_shard.config.count
dataset = one_shard.config.model_copy(update={"count": count})
train(Repeated(folder, dataset, system), config, out)
peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(memory_taken(dataset, system) / config.memory, peak / config.memory)
"""


def test_resident_memory_is_bounded_by_the_limit_and_not_by_the_dataset(tmp_path: Path):
    folder = tmp_path / "one"
    config = DatasetConfig(system="pendulum", substeps=5, count=9216, samples_per_run=36)
    generate(config, folder, threads=1)
    processes = []
    for shards in (1, 150):
        out = tmp_path / f"{shards}.safetensors"
        command = [sys.executable, "-c", MEASURE, str(folder), str(out), str(shards)]
        processes.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
    printed = [process.communicate()[0].split() for process in processes]
    (_, small_peak), (times_the_limit, large_peak) = [map(float, line) for line in printed]
    assert times_the_limit > 30
    assert large_peak - small_peak < 1


def test_data_that_fit_are_read_and_others_stay_on_disk(stored: StoredTransitions):
    assert isinstance(open_transitions(stored.folder), Transitions)
    assert isinstance(open_transitions(stored.folder, TWO_SHARDS), StoredTransitions)


def test_memory_for_less_than_a_shard_is_refused(stored: StoredTransitions):
    with pytest.raises(NeuroAnimatorError, match=r"memory: 1MB holds no shard.*at least 2MB"):
        stream_of(stored, small_config(memory=1_000_000)).shards_per_pool  # noqa: B018


def test_sizes_are_numbers_with_a_unit():
    assert TrainingConfig(memory="1.5GB").memory == 1_500_000_000
    for wrong in ("1gb", "GB", "much", "1MB"):
        with pytest.raises(NeuroAnimatorError, match="memory: "):
            TrainingConfig(memory=wrong)


def test_a_shard_that_changes_while_it_is_learnt_from_is_named(
    stored: StoredTransitions, tmp_path: Path
):
    stream = stream_of(stored, small_config())
    changed = WindowStream(
        stored, stream.base, stream.config, ("",) * 5, stream.counts, stream.rare_from
    )
    with pytest.raises(NeuroAnimatorError, match=r"shard-0000\d.safetensors has changed"):
        next(changed.pools(0))


def test_what_is_made_ahead_is_bounded_and_errors_arrive():
    made = []

    def numbers():
        for number in range(5):
            made.append(number)
            yield number
        raise ValueError("no more")

    ahead = Prefetched(numbers(), depth=2)
    time.sleep(0.05)
    assert made == [0, 1]
    assert list(islice(ahead, 5)) == [0, 1, 2, 3, 4]
    for _ in range(2):
        with pytest.raises(ValueError, match="no more"):
            next(ahead)
    ahead.close()
