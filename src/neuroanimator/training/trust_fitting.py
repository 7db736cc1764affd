"""Fit of `emulator.trust` to the last layer's activations on unseen runs.

Units of the last layer are whitened, so that distance in them is what an ensemble of last layers would disagree by. Of
the whitened directions those are kept in which errors are largest, and 99 of a hundred inputs score at most 1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from neuroanimator.data.store import Dataset, Transitions
from neuroanimator.data.stored import first_windows
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE, TrustMeter
from neuroanimator.state.arrays import as_rows
from neuroanimator.training.survey import base_windows

DIRECTIONS = 16
"""Directions that are measured: half as many tell a little less, all of them take as long as the network."""

MAX_INPUTS = 16_384
"""Super steps a meter is fitted to, at most."""

COVERED_SHARE = 0.99
"""Share of the inputs that score at most 1."""

FOLDS = 10
"""Number of parts that the segments of recordings are divided into, each measured by directions fitted to the others."""

RIDGE = 1e-3
"""Share of the units' mean variance that is added to each: what hardly varies is not divided by nothing."""

WEIGHT_SHARE = 0.999
"""Errors above this quantile count as much as it: one crash shall not choose all directions."""

SMALLEST = 1e-12
"""Variances and scores below this are nothing."""


def fit_trust(emulator: Emulator, data: Dataset) -> Emulator:
    """Return the emulator with a meter fitted to `data`: for files from before there was one, or for other uses.

    Data it was not trained on tell more of what it knows than those it was.
    """
    # Each window has several super steps, so this is more than enough.
    windows = base_windows(emulator, first_windows(data, MAX_INPUTS))
    return with_meter(emulator, windows)


def with_meter(emulator: Emulator, windows: Transitions) -> Emulator:
    """Return the emulator with a meter fitted to latent `windows`; of recordings its edge to segments it was not fitted to."""
    rows = (windows.states[:, :-1], windows.controls, windows.states[:, 1:])
    starts, held, ends = (as_jax(as_rows(row)[:MAX_INPUTS]) for row in rows)
    segments = None
    if windows.system.recordings is not None:
        segments = np.repeat(windows.run, windows.controls.shape[1])[:MAX_INPUTS]
    units = _units_and_errors(emulator, starts, held, ends)
    odd, even, errors = (np.asarray(rows, float) for rows in units)
    meter = fit_meter(odd, even, errors, segments)
    # Bounds of errors are by scores of another meter, and mostly of another network.
    return replace(emulator, meter=meter, calibration=None)


@eqx.filter_jit
def _units_and_errors(
    emulator: Emulator,
    starts: Float[Array, "M I"],
    controls: Float[Array, "M C"],
    ends: Float[Array, "M I"],
) -> tuple[Float[Array, "M H"], Float[Array, "M G"], Float[Array, " M"]]:
    """Return (odd units, even units, rms errors in units of the usual change) of super steps."""
    unit = emulator.normaliser.unit

    def one(
        start: Float[Array, " I"], control: Float[Array, " C"], end: Float[Array, " I"]
    ) -> tuple[Array, Array, Array]:
        _, units, _ = emulator.stride_and_units(start, control)
        following = emulator.step_latent_unbounded(start, control)
        difference = emulator.frame.difference(end, following)
        error = difference / jnp.where(unit > 0, unit, jnp.inf)
        return units.odd, units.even, jnp.sqrt(jnp.mean(error**2))

    return jax.vmap(one)(starts, controls, ends)


class _Directions(NamedTuple):
    """Directions of some units, the most telling last."""

    vectors: Float[np.ndarray, "H D"]
    telling: Float[np.ndarray, " D"]
    """Size of errors along each, over their mean."""


def fit_meter(
    odd: Float[np.ndarray, "M H"],
    even: Float[np.ndarray, "M G"],
    errors: Float[np.ndarray, " M"],
    segments: Int[np.ndarray, " M"] | None = None,
) -> TrustMeter:
    """Return the meter of these units, made by inputs with these `errors`.

    Inputs of one of the `segments` follow each other: of what a segment holds, the others say less than its own inputs
    do. So the edge is found by scores of segments to which the directions were not fitted. Without them inputs count as
    independent.
    """
    directions = _fit_directions(odd, even, errors)
    scores = directions.scores(odd, even)
    if segments is not None:
        scores = _scores_of_unseen(odd, even, errors, segments)
    edge = max(float(np.quantile(scores, COVERED_SHARE)), SMALLEST) / EDGE
    return TrustMeter(
        odd=(directions.odd / edge).astype(np.float32),
        even=(directions.even / edge).astype(np.float32),
        even_mean=directions.even_mean.astype(np.float32),
    )


def _scores_of_unseen(
    odd: Float[np.ndarray, "M H"],
    even: Float[np.ndarray, "M G"],
    errors: Float[np.ndarray, " M"],
    segments: Int[np.ndarray, " M"],
) -> Float[np.ndarray, " M"]:
    """Return the score of each input by directions that were fitted without its fold of the segments."""
    scores = np.empty(len(errors))
    numbers = np.unique(segments)
    for fold in range(FOLDS):
        is_unseen = np.isin(segments, numbers[fold::FOLDS])
        if not is_unseen.any():
            continue
        seen = ~is_unseen
        directions = _fit_directions(odd[seen], even[seen], errors[seen])
        scores[is_unseen] = directions.scores(odd[is_unseen], even[is_unseen])
    return scores


class _Measure(NamedTuple):
    """Directions of both kinds of units, and how far from what scores are measured."""

    odd: Float[np.ndarray, "H P"]
    even: Float[np.ndarray, "G Q"]
    even_mean: Float[np.ndarray, " G"]

    def scores(
        self, odd: Float[np.ndarray, "M H"], even: Float[np.ndarray, "M G"]
    ) -> Float[np.ndarray, " M"]:
        """Return the distance of each input's units, whose edge is yet to be found."""
        return np.sqrt(
            ((odd @ self.odd) ** 2).sum(1) + (((even - self.even_mean) @ self.even) ** 2).sum(1)
        )


def _fit_directions(
    odd: Float[np.ndarray, "M H"], even: Float[np.ndarray, "M G"], errors: Float[np.ndarray, " M"]
) -> _Measure:
    """Return the `DIRECTIONS` of whitened units that tell most of errors."""
    mean = even.mean(axis=0)
    weights = np.minimum(errors, np.quantile(errors, WEIGHT_SHARE))
    weights = weights / max(weights.mean(), SMALLEST)
    # Apart, as if every input came with its mirror image: then nothing of one goes along with the other.
    found = [_directions(rows, weights) for rows in (odd, even - mean)]
    least = np.sort(np.concatenate([one.telling for one in found]))[-DIRECTIONS:][0]
    odd_kept, even_kept = (one.vectors[:, one.telling >= least] for one in found)
    return _Measure(odd_kept, even_kept, mean)


def _directions(units: Float[np.ndarray, "M H"], weights: Float[np.ndarray, " M"]) -> _Directions:
    """Return the directions of whitened `units`, by how much inputs of large errors go along them."""
    size = units.shape[1]
    if not size:
        return _Directions(np.zeros((0, 0)), np.zeros(0))
    covariance = units.T @ units / len(units)
    ridge = RIDGE * np.trace(covariance) / size + SMALLEST
    variances, axes = np.linalg.eigh(covariance + ridge * np.eye(size))
    whitening = axes / np.sqrt(variances)
    white = units @ whitening
    telling, turned = np.linalg.eigh((white * weights[:, None]).T @ white / len(units))
    return _Directions(whitening @ turned, telling)
