"""How much data and how many updates fit into some minutes on this machine, measured by a pilot of each."""

from __future__ import annotations

import time
from contextlib import closing

import numpy as np

from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.config import RUNS_PER_SHARD, DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.store import Dataset
from neuroanimator.learn.training.checkpoint import TrainingState
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK, TrainingConfig
from neuroanimator.learn.training.lesson import lesson_of
from neuroanimator.learn.training.optimizer import make_optimizer

DATA_SHARE = 0.4
"""Share of the time for data: after that, more updates gain as much as more data."""

MARGIN = 0.85
"""Share of the time left that is planned: for validation, and for what else the machine does."""

PILOT_RUNS = RUNS_PER_SHARD // 8
"""Number of simulated runs that are timed."""

MIN_TRANSITIONS = 6_000
"""Minimum number of transitions, below which emulators are useless."""

MAX_TIMES = 4
"""Maximum number of updates, over the usual ones: more gain nothing from the same data."""


def transitions_within(config: DatasetConfig, seconds: float) -> int:
    """Return the number of transitions that this machine simulates in `seconds`, at most those of `config`.

    Raises ArgumentError if these are too few to learn from.
    """
    pilot = config.model_copy(update={"count": PILOT_RUNS * config.samples_per_run})
    simulate_transitions(pilot)  # loads what later ones have
    began = time.monotonic()
    simulate_transitions(pilot)
    pace = pilot.count / (time.monotonic() - began)
    fewest = min(MIN_TRANSITIONS, config.count)
    count = min(config.count, int(pace * seconds))
    if count < fewest:
        least = fewest / pace / DATA_SHARE / 60
        raise ArgumentError(
            f"minutes: {fewest:,} transitions, the fewest to learn from, need {least:.2g} of them here; got "
            f"{seconds / DATA_SHARE / 60:.2g}."
        )
    return count


def updates_within(data: Dataset, config: TrainingConfig, seconds: float) -> int:
    """Return the number of updates of a training on `data` that ends `seconds` from now, at most four times the usual.

    What it compiles to measure that, the training uses. Raises ArgumentError if there is time for none.
    """
    deadline = time.monotonic() + seconds
    lesson = lesson_of(data, config, None)
    network = lesson.problem.base.network
    fresh = TrainingState.fresh(network, make_optimizer(config))
    unrolls = [config.unroll_at(chunk) for chunk in range(config.chunks)]
    pace = {}
    with closing(lesson.feed):
        for unroll in sorted(set(unrolls)):
            for _ in range(2):  # the first one compiles
                began = time.monotonic()
                lesson.feed.train(network, fresh.optimizer_state, unrolls.index(unroll))
                pace[unroll] = time.monotonic() - began
    mean = float(np.mean([pace[unroll] for unroll in unrolls]))
    left = MARGIN * (deadline - time.monotonic())
    chunks = min(int(left / mean), MAX_TIMES * config.chunks)
    if chunks < 1:
        raise ArgumentError(
            f"minutes: no time is left for updates, of which {UPDATES_PER_CHUNK} take {mean:.2g} s here. Allow more."
        )
    return chunks * UPDATES_PER_CHUNK
