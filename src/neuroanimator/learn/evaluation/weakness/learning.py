"""Train an emulator on with new windows mixed with old ones, so that it stays accurate on those."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.description import describe
from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.mode_fitting import with_wider_limits
from neuroanimator.emulator.shape_modes import ShapeModes
from neuroanimator.learn.data.store import Transitions, windows_of
from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.learn.evaluation.weakness.config import ImprovementConfig
from neuroanimator.learn.evaluation.weakness.sampling import RunBatch, errors_on, join_runs
from neuroanimator.learn.training.chunk import completed
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.lesson import keeps_still
from neuroanimator.learn.training.train import Report, train
from neuroanimator.learn.training.trust_fitting import fit_trust

QUANTILE = 0.95
"""Quantile of the one-step errors on a test that is called the error there."""

MAX_USUAL_GROWTH = 1.1
"""Largest accepted growth factor of the error on usual motions; emulators beyond it are rejected."""

SHARES = (0.75, 0.5, 0.25, 0.1)
"""Shares of the way from the given weights to the trained ones that are tried if the latter are rejected."""

FULL_WEIGHT = 3.0
"""Largest error of a new window that counts fully, as a multiple of the usual error."""

STEEPNESS = 2.0
"""Power of the error with which the weight of larger errors falls."""

GROUPS = 40
"""Number of equal groups of windows, each of whole runs; training validates on two of them."""

NEW_SHARE = 0.1
"""Share of new windows, repeated where they are fewer. Their errors are several times as large, and count squared: at
one half, errors on usual motions grew by a third."""

WARM_RATE = 0.3
"""Highest learning rate, over that of a fresh training: the weights are nearly right."""

UNROLLED_SHARE = 0.2
"""Share of the updates unrolled over several super steps."""

OUTERMOST = 1e-3
"""Share of the new windows, on either side, that may lie outside the range: outliers are not learnt."""

MIXING_STREAM = 5
"""Number that names, with the seed, the random stream from which windows are drawn."""


def error_on(emulator: Emulator, test: HeldOut) -> float:
    """Return the 95th percentile of one-step errors on a test [standard deviations of the usual change]."""
    return float(np.quantile(errors_on(emulator, test), QUANTILE))


@dataclass
class RoundTrainer:
    """Trains on, round by round, from a given emulator."""

    data: Transitions
    """Old windows."""
    given: Emulator
    guard: HeldOut
    """Usual motions by which emulators are accepted or rejected."""
    config: ImprovementConfig

    @cached_property
    def usual_error(self) -> float:
        """Error of the given emulator on the guard."""
        return error_on(self.given, self.guard)

    def learn(
        self,
        emulator: Emulator,
        samples: Sequence[RunBatch],
        path: Path,
        on_report: Callable[[Report], None] = lambda report: None,
    ) -> Emulator:
        """Return `emulator` trained on with the runs of all rounds so far, and write it to `path`."""
        new = cut_windows(join_runs(samples), self.data.system.window_steps)
        weights = np.concatenate([self._weights(emulator, runs) for runs in samples])
        windows = mix_windows(self.data, new, self.config, weights=weights)
        return train_on(emulator, new, windows, path, self.config, on_report)

    def _weights(self, emulator: Emulator, runs: RunBatch) -> Float[np.ndarray, " M"]:
        """Return the weight of each window of `runs`: large errors count less.

        Errors count squared; those a hundred times the usual ones would outweigh all others (weights of Cauchy's
        estimator: Holland and Welsch, 1977).
        """
        test = replace(self.guard, states=runs.states, controls=runs.controls)
        windows = runs.controls.shape[1] - self.data.system.window_steps + 1
        errors = errors_on(emulator, test)[:, :windows].ravel()
        return 1 / np.maximum(1, errors / (FULL_WEIGHT * self.usual_error)) ** STEEPNESS

    def accept(self, trained: Emulator) -> Emulator | None:
        """Return the emulator nearest to `trained`, between it and the given one, that is as good as that on usual motions.

        Weights are interpolated linearly (Wortsman et al., Robust fine-tuning of zero-shot models, 2022). None if no
        share passes.
        """
        limit = MAX_USUAL_GROWTH * self.usual_error
        if error_on(trained, self.guard) <= limit:
            return trained
        for share in SHARES:
            between = self._between(trained, share)
            if error_on(between, self.guard) <= limit:
                return fit_trust(between, self.data)
        return None

    def _between(self, trained: Emulator, share: float) -> Emulator:
        """Return `trained` with weights a `share` of the way from the given ones; at rest where the system rests."""
        base = replace(trained, normaliser=self.given.normaliser)
        old, others = eqx.partition(self.given.network, eqx.is_inexact_array)
        new, _ = eqx.partition(trained.network, eqx.is_inexact_array)
        weights = jax.tree.map(lambda one, other: (1 - share) * one + share * other, old, new)
        rest = base.rest_streams() if keeps_still(self.data.system, base) else None
        return completed(base, eqx.combine(weights, others), rest)


def cut_windows(runs: RunBatch, length: int) -> RunBatch:
    """Return every window of `length` super steps of the runs."""
    count, steps, _ = runs.controls.shape
    samples = np.tile(np.arange(steps - length + 1), (count, 1))
    tensors = {"states": runs.states, "controls": runs.controls, "samples": samples}
    return RunBatch(*windows_of(tensors, length))


def mix_windows(
    old: Transitions,
    new: RunBatch,
    config: ImprovementConfig,
    new_share: float = NEW_SHARE,
    weights: Float[np.ndarray, " N"] | None = None,
) -> Transitions:
    """Return old and new windows, always the same numbers of each, so that all rounds are compiled once.

    New ones are drawn in proportion to `weights`. Groups stand for runs: no round learns from windows of a group that
    training validates on.
    """
    rng = np.random.default_rng([config.seed, MIXING_STREAM])
    of_new = round(config.windows * new_share / GROUPS)
    of_old = round(config.windows * (1 - new_share) / GROUPS)
    states = []
    controls = []
    sizes = []
    for group in range(GROUPS):
        old_rows = resample(rng, np.flatnonzero(old.run % GROUPS == group), of_old)
        new_rows = np.flatnonzero(new.source % GROUPS == group)
        new_rows = resample(rng, new_rows, of_new, weights)
        states += [old.states[old_rows], new.states[new_rows]]
        controls += [old.controls[old_rows], new.controls[new_rows]]
        sizes.append(len(old_rows) + len(new_rows))
    return replace(
        old,
        states=np.concatenate(states),
        controls=np.concatenate(controls),
        run=np.repeat(np.arange(GROUPS), sizes),
        diverged=0,
        held_out=None,
    )


def resample(
    rng: np.random.Generator,
    rows: Int[np.ndarray, " N"],
    count: int,
    weights: Float[np.ndarray, " _"] | None = None,
) -> Int[np.ndarray, " M"]:
    """Return `count` of `rows`, equally often or in proportion to `weights`, up to one (systematic resampling)."""
    if not len(rows):
        return rows
    if weights is not None:
        ends = np.cumsum(weights[rows]) / weights[rows].sum()
        marks = (np.arange(count) + rng.random()) / count
        return rows[np.minimum(np.searchsorted(ends, marks), len(rows) - 1)]
    times = count // len(rows)
    more = rng.permutation(len(rows))[: count - times * len(rows)]
    return np.concatenate([np.tile(rows, times), rows[more]])


def train_on(
    emulator: Emulator,
    new: RunBatch,
    windows: Transitions,
    path: Path,
    config: ImprovementConfig,
    on_report: Callable[[Report], None],
) -> Emulator:
    """Return `emulator` with its range widened to `new` windows, trained on with `windows` from its weights."""
    usual = TrainingConfig.usual(
        windows.system.structure,
        network=describe(emulator)["network"]["kind"],
        widths=emulator.network.widths,
    )
    changes = {
        "updates": config.updates,
        "learning_rate": usual.learning_rate * WARM_RATE,
        "unroll_share": UNROLLED_SHARE,
        "seed": config.seed,
    }
    warm = TrainingConfig(**(usual.model_dump() | changes))
    return train(windows, warm, path, start_from=widen(emulator, new), on_report=on_report)


def widen(emulator: Emulator, new: RunBatch) -> Emulator:
    """Return the emulator with its range widened to `new` windows; its weights and normaliser stay.

    Within the old range, where no feature was clipped, nothing changes.
    """
    encoding = emulator.encoding
    states = encoding.encode_recorded(new.states[:, :-1])
    controls = np.asarray(emulator.encode_control(new.controls))
    raw = np.asarray(emulator.raw_features(np.asarray(states), controls), float)
    raw = raw.reshape(-1, raw.shape[-1])
    low, high = np.quantile(raw, [OUTERMOST, 1 - OUTERMOST], axis=0)
    features = emulator.features
    is_even = np.isin(np.arange(len(low)), features.even)
    is_odd = features.is_odd & ~is_even
    high = np.where(is_odd, np.maximum(-low, high), high)
    low = np.where(is_odd, -high, low)
    domain = Domain(
        as_jax(np.minimum(np.asarray(emulator.domain.low), low)),
        as_jax(np.maximum(np.asarray(emulator.domain.high), high)),
    )
    if isinstance(encoding, ShapeModes):
        encoding = with_wider_limits(encoding, states.reshape(-1, states.shape[-1]))
    return replace(emulator, domain=domain, encoding=encoding)
