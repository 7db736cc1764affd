"""On-line and batch learning with momentum beside today's optimisers, after equal numbers of examples seen."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

import neuroanimator as na
from classic_cases.lessons import (
    FEATURES,
    Lesson,
    Sampler,
    random_batches,
    train_side_by_side,
)
from neuroanimator.training.optimizer import MOMENTUM, make_optimizer

Rows = list[dict[str, Any]]

UNITS = 35
"""Number of hidden units: the middle of 20 to 50."""

COUNT = 6_000
"""Number of transitions; a batch holds all of them."""

SEEN = 600_000
"""Number of examples seen at the end, with repetition."""

STOPS = (0.005, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Shares of the examples after which errors are measured; a batch of all examples comes to 100 updates."""

SEEDS = 3
"""Number of trainings of each way."""

ASCENT = -1.0
"""Factor of the learning rate in eq. (6) as it is printed."""


class Way(NamedTuple):
    """A way to learn."""

    name: str
    batch: int
    """Number of examples between two changes of the weights; 0 for all of them."""
    rates: tuple[float, ...]
    """Learning rates tried; the best by the error of the first seed is reported."""
    momentum: float = 0.0
    sign: float = 1.0
    is_muon: bool = False
    is_adam: bool = False

    def size(self, rows: int) -> int:
        """Return the number of examples between two changes of the weights."""
        return self.batch or rows

    def optimizer(self, rate: float, updates: int) -> optax.GradientTransformation:
        """Return the optimiser: of today's ways as `train` makes it, its rate falling along a cosine."""
        if self.is_muon or self.is_adam:
            kind = "muon" if self.is_muon else "adam"
            settings = na.TrainingConfig(
                network="classic",
                widths=(UNITS,),
                optimizer=kind,
                learning_rate=rate,
                updates=updates,
            )
            return make_optimizer(settings)
        return optax.sgd(self.sign * rate, momentum=self.momentum or None)

    def sampler(self, rows: int) -> Sampler:
        """Return what draws the examples of an update: at random, or all."""
        if self.batch:
            return random_batches(self.batch, rows)
        return lambda key, update: jnp.arange(rows)


WAYS = (
    Way("batch, as printed", 0, (0.03,), MOMENTUM, sign=ASCENT),
    Way("batch", 0, (0.1, 0.3, 1.0, 3.0)),
    Way("batch, momentum", 0, (0.1, 0.3, 1.0, 3.0), MOMENTUM),
    Way("on-line", 1, (0.01, 0.03, 0.1)),
    Way("on-line, momentum", 1, (0.001, 0.003, 0.01), MOMENTUM),
    Way("mini-batch, momentum", 64, (0.1, 0.3, 1.0), MOMENTUM),
    Way("mini-batch, Adam", 64, (0.01, 0.03, 0.1), is_adam=True),
    Way("mini-batch, Muon", 64, (0.01, 0.03, 0.1), is_muon=True),
)
"""Every way, the oldest first."""


def learning_rows(is_quick: bool) -> Rows:
    """Return a row per way and number of examples seen: errors on unseen runs, their median over seeds."""
    count = 1_800 if is_quick else COUNT
    seen = 36_000 if is_quick else SEEN
    lesson = Lesson.of("pendulum", 50, count, FEATURES)
    rows = []
    for way in WAYS:
        rows += rows_of_way(lesson, way, seen, 1 if is_quick else SEEDS)
    return rows


def rows_of_way(lesson: Lesson, way: Way, seen: int, seeds: int) -> Rows:
    """Return the rows of one way at the best of its learning rates."""
    best_rate = way.rates[0]
    if len(way.rates) > 1:
        last_errors = []
        for rate in way.rates:
            curve, _ = errors_along(lesson, way, rate, seen, 1)
            last_errors.append(curve[-1, 0])
        best_rate = way.rates[int(np.argmin(last_errors))]
    errors, seconds = errors_along(lesson, way, best_rate, seen, seeds)
    rows = []
    for number, share in enumerate(STOPS):
        rows.append(
            {
                "way": way.name,
                "batch": way.size(lesson.size),
                "rate": best_rate,
                "rates_tried": "; ".join(f"{rate:g}" for rate in way.rates),
                "examples_seen": round(share * seen),
                "updates": round(share * seen / way.size(lesson.size)),
                "seeds": seeds,
                "one_step_error": float(np.median(errors[number])),
                "one_step_least": float(errors[number].min()),
                "one_step_largest": float(errors[number].max()),
                "seconds_a_training": seconds,
            }
        )
    return rows


def errors_along(
    lesson: Lesson, way: Way, rate: float, seen: int, seeds: int
) -> tuple[np.ndarray, float]:
    """Return (one-step errors (stops, seeds), time of one training [s], compiling included)."""
    updates = seen // way.size(lesson.size)
    stops = tuple(max(1, round(share * updates)) for share in STOPS)
    began = time.perf_counter()
    snapshots = train_side_by_side(
        lesson,
        lesson.network("classic", (UNITS,)),
        way.optimizer(rate, updates),
        way.sampler(lesson.size),
        stops,
        seeds,
    )
    jax.block_until_ready(snapshots)
    seconds = (time.perf_counter() - began) / seeds
    errors = [[lesson.one_step_error(network) for network in networks] for networks in snapshots]
    return np.nan_to_num(np.array(errors), nan=np.inf), seconds
