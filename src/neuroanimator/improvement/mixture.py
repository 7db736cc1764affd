"""New windows among old ones: always as many of either, so that what was known is kept and nothing is compiled twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.data.config import MAX_UNROLL, DatasetConfig
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.description import describe
from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.mode_fitting import with_wider_limits
from neuroanimator.emulator.shape_modes import ShapeModes
from neuroanimator.improvement.config import ImprovementConfig
from neuroanimator.improvement.samples import Windows
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import System
from neuroanimator.training.config import TrainingConfig

GROUPS = 40
"""All windows of a run are in one group; groups are equally large, and training validates on two of them."""

NEW_SHARE = 0.1
"""Share of them that are new, repeated where they are fewer. Their errors are several times as large, and count squared: with
half of them new, errors on usual motions grew by a third."""

WARM_RATE = 0.3
"""Highest learning rate, as a share of a fresh training's: the weights are nearly right."""

UNROLLED_SHARE = 0.2
"""Share of the updates that are unrolled over several super steps."""

OUTERMOST = 1e-3
"""Share of the new windows on either side that may lie outside the range: what only a few showed is not learnt."""

MIXING_STREAM = 5
"""Windows are drawn from a stream of their own: the seed with this number."""


def mixed(
    old: Transitions,
    new: Windows,
    config: ImprovementConfig,
    new_share: float = NEW_SHARE,
    weights: Float[np.ndarray, " N"] | None = None,
) -> Transitions:
    """Return old and new windows, always as many of either, however many there are; new ones in proportion to `weights`.

    The groups stand for runs: what training validates on it never learns from, whichever round it is.
    """
    rng = np.random.default_rng([config.seed, MIXING_STREAM])
    of_new = round(config.windows * new_share / GROUPS)
    of_old = round(config.windows * (1 - new_share) / GROUPS)
    states = []
    controls = []
    sizes = []
    for group in range(GROUPS):
        old_rows = resampled(rng, np.flatnonzero(old.run % GROUPS == group), of_old)
        new_rows = np.flatnonzero(new.run % GROUPS == group)
        if weights is None:
            new_rows = resampled(rng, new_rows, of_new)
        else:
            new_rows = drawn_by(rng, new_rows, weights[new_rows], of_new)
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


def only_new(
    dataset: DatasetConfig, system: System, new: Windows, config: ImprovementConfig
) -> Transitions:
    """Return new windows alone, in groups as `mixed` has them: where there is nothing old."""
    rng = np.random.default_rng([config.seed, MIXING_STREAM])
    of_each = config.windows // GROUPS
    groups = [
        resampled(rng, np.flatnonzero(new.run % GROUPS == group), of_each)
        for group in range(GROUPS)
    ]
    rows = np.concatenate(groups)
    return Transitions(
        dataset, system, new.states[rows], new.controls[rows], new.run[rows] % GROUPS, diverged=0
    )


def resampled(
    rng: np.random.Generator, rows: Int[np.ndarray, " N"], count: int
) -> Int[np.ndarray, " M"]:
    """Return `count` of `rows`: each as often as any other, but for one more."""
    if not len(rows):
        return rows
    times = count // len(rows)
    more = rng.permutation(len(rows))[: count - times * len(rows)]
    return np.concatenate([np.tile(rows, times), rows[more]])


def drawn_by(
    rng: np.random.Generator,
    rows: Int[np.ndarray, " N"],
    weights: Float[np.ndarray, " N"],
    count: int,
) -> Int[np.ndarray, " M"]:
    """Return `count` of `rows`, each as often as its weight says, but for less than one (systematic resampling)."""
    if not len(rows):
        return rows
    ends = np.cumsum(weights) / weights.sum()
    marks = (np.arange(count) + rng.random()) / count
    return rows[np.minimum(np.searchsorted(ends, marks), len(rows) - 1)]


def widened(emulator: Emulator, new: Windows) -> Emulator:
    """Return the emulator that is shown what lies as far out as `new` windows; it keeps its weights and its numbers' scales.

    Where it has learnt, nothing changes: there no feature was brought into the range.
    """
    states = emulator.encoding.encode_recorded(new.states[:, :MAX_UNROLL])
    controls = np.asarray(emulator.encode_control(new.controls))
    raw = np.asarray(emulator.raw_features(np.asarray(states), controls), float)
    raw = raw.reshape(-1, raw.shape[-1])
    low, high = np.quantile(raw, [OUTERMOST, 1 - OUTERMOST], axis=0)
    features = emulator.features
    size = raw.shape[1]
    is_odd = np.array([features.is_odd and entry not in features.even for entry in range(size)])
    high = np.where(is_odd, np.maximum(-low, high), high)
    low = np.where(is_odd, -high, low)
    domain = emulator.domain
    wider = Domain(
        as_jax(np.minimum(np.asarray(domain.low), low)),
        as_jax(np.maximum(np.asarray(domain.high), high)),
    )
    encoding = emulator.encoding
    if isinstance(encoding, ShapeModes):
        encoding = with_wider_limits(encoding, states.reshape(-1, states.shape[-1]))
    return replace(emulator, domain=wider, encoding=encoding)


def warm_config(
    emulator: Emulator, structure: Structure, updates: int, seed: int
) -> TrainingConfig:
    """Return how to train on from the emulator's weights."""
    usual = TrainingConfig.usual(
        structure, network=describe(emulator)["network"]["kind"], widths=emulator.network.widths
    )
    changes = {
        "updates": updates,
        "learning_rate": usual.learning_rate * WARM_RATE,
        "unroll_share": UNROLLED_SHARE,
        "seed": seed,
    }
    return TrainingConfig(**(usual.model_dump() | changes))
