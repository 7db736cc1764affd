"""Fit of `emulator.trust` to the last layer's activations on unseen runs.

Units of the last layer are whitened, so that distances in them are the disagreement of an ensemble of last layers. The
whitened directions with the largest errors are kept, and scaled so that 99 of a hundred inputs score at most 1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE, TrustMeter
from neuroanimator.learn.data.store import Dataset, Transitions
from neuroanimator.learn.data.stored import first_windows
from neuroanimator.learn.training.survey import base_windows
from neuroanimator.state.arrays import as_rows

DIRECTIONS = 16
"""Number of directions: half of them predict slightly worse, all would take as long as the network."""

MAX_INPUTS = 16_384
"""Maximum number of super steps to which a meter is fitted."""

COVERED_SHARE = 0.99
"""Share of the inputs that score at most 1."""

FOLDS = 10
"""Number of folds of the segments of recordings, each scored by directions fitted to the others."""

RIDGE = 1e-3
"""Share of the units' mean variance added to each, so that nearly constant units are not divided by zero."""

WEIGHT_SHARE = 0.999
"""Quantile to which larger errors are clipped, so that one crash does not choose all directions."""

SMALLEST = 1e-12
"""Variance and score below which they count as zero."""


def fit_trust(emulator: Emulator, data: Dataset) -> Emulator:
    """Return the emulator with a trust meter fitted to `data`: for files from before there was one, or for other uses.

    Data it was not trained on say more than its training data.
    """
    # Each window has several super steps, so this is more than enough.
    windows = base_windows(emulator, first_windows(data, MAX_INPUTS))
    return with_meter(emulator, windows)


def with_meter(emulator: Emulator, windows: Transitions) -> Emulator:
    """Return the emulator with a meter fitted to latent `windows`; for recordings its edge is found on held-out segments."""
    rows = (windows.states[:, :-1], windows.controls, windows.states[:, 1:])
    starts, held, ends = (as_jax(as_rows(row)[:MAX_INPUTS]) for row in rows)
    segments = None
    if windows.system.recordings is not None:
        segments = np.repeat(windows.run, windows.controls.shape[1])[:MAX_INPUTS]
    found = _units_and_errors(emulator, starts, held, ends)
    meter = fit_meter(Inputs(*(np.asarray(column, float) for column in found)), segments)
    # Existing error bounds belong to the scores of another meter, and mostly of another network.
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


class Inputs(NamedTuple):
    """Units of the last layer for M inputs, and the errors of the answers."""

    odd: Float[np.ndarray, "M H"]
    even: Float[np.ndarray, "M G"]
    errors: Float[np.ndarray, " M"]

    def where(self, rows: Bool[np.ndarray, " M"]) -> Inputs:
        """Return the inputs that `rows` selects."""
        return Inputs(*(column[rows] for column in self))

    def scores(self, meter: TrustMeter) -> Float[np.ndarray, " M"]:
        """Return the score of each by `meter`, in double precision."""
        even = (self.even - meter.even_mean) @ meter.even
        return np.sqrt(((self.odd @ meter.odd) ** 2).sum(1) + (even**2).sum(1))


def fit_meter(inputs: Inputs, segments: Int[np.ndarray, " M"] | None = None) -> TrustMeter:
    """Return the meter of some inputs.

    Inputs within one of the `segments` are correlated, so a segment is predicted better by its own inputs than by others.
    So the edge is found from scores of segments left out of the fit of the directions. Without `segments`, inputs count
    as independent.
    """
    meter = _unscaled_meter(inputs)
    scores = inputs.scores(meter)
    if segments is not None:
        numbers = np.unique(segments)
        scores = np.empty(len(scores))
        for fold in range(FOLDS):
            is_unseen = np.isin(segments, numbers[fold::FOLDS])
            if is_unseen.any():
                others = _unscaled_meter(inputs.where(~is_unseen))
                scores[is_unseen] = inputs.where(is_unseen).scores(others)
    edge = max(float(np.quantile(scores, COVERED_SHARE)), SMALLEST) / EDGE
    return TrustMeter(
        odd=(meter.odd / edge).astype(np.float32),
        even=(meter.even / edge).astype(np.float32),
        even_mean=meter.even_mean.astype(np.float32),
    )


def _unscaled_meter(inputs: Inputs) -> TrustMeter:
    """Return the meter of the `DIRECTIONS` of whitened units that best predict errors, before scaling to the edge."""
    mean = inputs.even.mean(axis=0)
    weights = np.minimum(inputs.errors, np.quantile(inputs.errors, WEIGHT_SHARE))
    weights = weights / max(weights.mean(), SMALLEST)
    # Separately, as if every input came with its mirror image: then odd and even units are uncorrelated.
    found = [_directions(rows, weights) for rows in (inputs.odd, inputs.even - mean)]
    least = np.sort(np.concatenate([telling for _, telling in found]))[-DIRECTIONS:][0]
    odd, even = (vectors[:, telling >= least] for vectors, telling in found)
    return TrustMeter(odd, even, mean)


def _directions(
    units: Float[np.ndarray, "M H"], weights: Float[np.ndarray, " M"]
) -> tuple[Float[np.ndarray, "H D"], Float[np.ndarray, " D"]]:
    """Return (directions of whitened `units`, the size of errors along each over their mean), the most telling last."""
    size = units.shape[1]
    if not size:
        return np.zeros((0, 0)), np.zeros(0)
    covariance = units.T @ units / len(units)
    ridge = RIDGE * np.trace(covariance) / size + SMALLEST
    variances, axes = np.linalg.eigh(covariance + ridge * np.eye(size))
    whitening = axes / np.sqrt(variances)
    white = units @ whitening
    telling, turned = np.linalg.eigh((white * weights[:, None]).T @ white / len(units))
    return whitening @ turned, telling
