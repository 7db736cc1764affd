"""Scales of states: super steps neither too long for the motion nor too short for noise, and numbers an emulator can hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.checks import MAX_MAGNITUDE
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.errors import BadFileError
from neuroanimator.physics.recorded.rates import Runs, changes_of
from neuroanimator.scaffold.structure import States, Step

MAX_CHANGE = 0.2
"""Largest change of a slow system in a super step, as a share of its range of motion."""

MAX_CHANGE_THROUGH_NOISE = 0.5
"""The same if noise calls for a longer super step."""

MAX_NOISE = 0.2
"""Largest share of noise in the changes in a super step."""

MAX_SUBSTEPS = 1000
"""Maximum number of steps in a super step."""

MAX_STATE = 64
"""Maximum size of a state whose rates are estimated, by two calls for each number."""

DIFFERENCE = 1e-4
"""Finite difference of a number of the state, as a share of its spread."""

MIN_FACTOR = 1e-9
"""Smallest decay factor of a step: what decays faster is gone."""

OTHER_UNIT = "Give it in another unit, written as the unit 1."
"""Advice about a number that is too large or too small."""

Noise = Float[np.ndarray, " S"]
"""Standard deviation of the noise in each number of a state."""


def share_of_change(runs: Runs, noise: Noise, span: int) -> Float[np.ndarray, " S"]:
    """Return the change of each number in `span` samples, as a share of its range of motion, without noise.

    1 is the difference between two independent samples.
    """
    variance = np.concatenate(runs).var(axis=0) - noise**2
    change = _variance_of_change(runs, span) - 2 * noise**2
    shares = np.zeros(len(noise))
    moves = variance > 0
    shares[moves] = np.sqrt(np.maximum(change[moves], 0) / (2 * variance[moves]))
    return shares


def share_of_noise(runs: Runs, noise: Noise, span: int) -> float:
    """Return the share of noise in the changes over `span` samples, in root mean squares over what moves."""
    change = _variance_of_change(runs, span)
    moves = change > 0
    if not moves.any():
        return 0.0
    return float(np.sqrt(np.mean(2 * noise[moves] ** 2 / change[moves])))


def _variance_of_change(runs: Runs, span: int) -> Float[np.ndarray, " S"]:
    """Return the variance of each number's change over `span` samples; zeros if no run is long enough."""
    changes = changes_of(runs, span)
    return changes.var(axis=0) if len(changes) else np.zeros(changes.shape[1])


def slow_substeps(runs: Runs, noise: Noise, usual: int) -> int:
    """Return the proposed number of samples in a super step of a slow system, which should move it only a little."""
    return _lengthened(runs, noise, (usual, MAX_SUBSTEPS), MAX_CHANGE, noise_from=-1.0)


def substeps_through_noise(runs: Runs, noise: Noise, usual: int, most: int) -> int:
    """Return the number of samples in a super step whose changes stand out from noise: `usual` to `most`."""
    return _lengthened(runs, noise, (usual, most), MAX_CHANGE_THROUGH_NOISE, noise_from=MAX_NOISE)


def _lengthened(
    runs: Runs, noise: Noise, ends: tuple[int, int], max_change: float, noise_from: float
) -> int:
    """Return the super step between `ends` in whose changes the share of noise falls to `noise_from`.

    It is shorter if something would change by more than the share `max_change`.
    """
    substeps, most = ends
    most = min(most, MAX_SUBSTEPS, max(len(states) for states in runs) - 1)
    while substeps < most and share_of_noise(runs, noise, substeps) > noise_from:
        if share_of_change(runs, noise, substeps + 1).max() > max_change:
            break
        substeps += 1
    return substeps


def fastest_rate(step: Step, states: States, dt: float) -> float:
    """Return the rate of the fastest motion of a step function [1/s], by the eigenvalues of its step around `states`.

    0 for large systems, whose rates are not estimated.
    """
    count, size = states.shape
    if size > MAX_STATE:
        return 0.0
    shifts = DIFFERENCE * np.maximum(states.std(axis=0), DIFFERENCE)
    slopes = np.zeros((count, size, size))
    for entry, shift in enumerate(np.diag(shifts)):
        slopes[:, :, entry] = (step(states + shift) - step(states - shift)) / (2 * shifts[entry])
    factors = np.linalg.eigvals(slopes[np.isfinite(slopes).all(axis=(1, 2))])
    if not factors.size:
        return 0.0
    sizes = np.maximum(np.abs(factors), MIN_FACTOR)
    rates = np.abs(np.log(sizes) + 1j * np.angle(factors)) / dt
    return float(np.median(rates.max(axis=1)))


def refuse_large(file: str, names: Sequence[str], states: States) -> None:
    """Raise BadFileError for a number of the state that is larger than an emulator takes; `names` are with units."""
    for name, magnitude in zip(names, np.abs(states).max(axis=0), strict=True):
        if magnitude > MAX_MAGNITUDE:
            raise BadFileError(
                f"{file}: state.{name} reaches {magnitude:.3g}; an emulator takes at most {MAX_MAGNITUDE:g}. {OTHER_UNIT}"
            )


def warn_of_small(names: Sequence[str], changes: States) -> Iterator[str]:
    """Yield a line for each number of the state whose `changes` in a super step are too small to count, but not zero."""
    for name, deviation in zip(names, changes.std(axis=0), strict=True):
        if 0 < deviation < MIN_CHANGE:
            yield (
                f"state.{name}: changes by {deviation:.2g} in a super step, and less than {MIN_CHANGE:g} is taken for "
                f"rounding. {OTHER_UNIT}"
            )
