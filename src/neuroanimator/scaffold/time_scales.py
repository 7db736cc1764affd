"""How long a super step should be: short against the time a system takes to change, long against its recordings' noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from neuroanimator.scaffold.defaults import WANTED_SUPER_STEP

MAX_CHANGE = 0.2
"""In a super step of something slow, nothing should change by more than this share of how far it goes at all."""

MAX_CHANGE_THROUGH_NOISE = 0.5
"""The same where noise wants a longer super step."""

MAX_NOISE = 0.2
"""Noise should make no more than this share of the changes in a super step."""

MAX_SUBSTEPS = 1000
"""Maximum number of steps in a super step."""

MAX_STATE = 64
"""The rates of larger systems are not looked for: that takes two calls for each number of the state."""

DIFFERENCE = 1e-4
"""Share of its spread by which a number of the state is moved to see what follows."""

MIN_FACTOR = 1e-9
"""What shrinks by more than this in a step is gone."""


def is_slow(step: float) -> bool:
    """Return whether a super step cannot be as short as is usual, for one step of `step` [s] is longer."""
    return step > WANTED_SUPER_STEP


def share_of_change(
    runs: list[Float[np.ndarray, "_ S"]], noise: Float[np.ndarray, " S"], span: int
) -> Float[np.ndarray, " S"]:
    """Return how far each number goes in `span` samples, as a share of how far it goes at all; noise does not count.

    1 is as far as between two samples that know nothing of each other.
    """
    variance = np.concatenate(runs).var(axis=0) - noise**2
    change = _variance_of_change(runs, span) - 2 * noise**2
    shares = np.zeros(len(noise))
    moves = variance > 0
    shares[moves] = np.sqrt(np.maximum(change[moves], 0) / (2 * variance[moves]))
    return shares


def share_of_noise(
    runs: list[Float[np.ndarray, "_ S"]], noise: Float[np.ndarray, " S"], span: int
) -> float:
    """Return how much of the changes over `span` samples is noise, in root mean squares over what moves."""
    change = _variance_of_change(runs, span)
    moves = change > 0
    if not moves.any():
        return 0.0
    return float(np.sqrt(np.mean(2 * noise[moves] ** 2 / change[moves])))


def _variance_of_change(runs: list[Float[np.ndarray, "_ S"]], span: int) -> Float[np.ndarray, " S"]:
    """Return the variance of each number's change over `span` samples; zeros where no run is long enough."""
    changes = np.concatenate([states[span:] - states[:-span] for states in runs])
    if not len(changes):
        return np.zeros(changes.shape[1])
    return changes.var(axis=0)


def slow_substeps(
    runs: list[Float[np.ndarray, "_ S"]], noise: Float[np.ndarray, " S"], usual: int
) -> int:
    """Return how many samples of something slow a super step should have: as many as leave it near where it was."""
    substeps = usual
    longest = max(len(states) for states in runs)
    while substeps < min(MAX_SUBSTEPS, longest - 1):
        if share_of_change(runs, noise, substeps + 1).max() > MAX_CHANGE:
            break
        substeps += 1
    return substeps


def substeps_through_noise(
    runs: list[Float[np.ndarray, "_ S"]],
    noise: Float[np.ndarray, " S"],
    usual: int,
    most: int,
) -> int:
    """Return how many samples a super step should have so that its changes stand out from noise: `usual` to `most`."""
    longest = max(len(states) for states in runs)
    substeps = usual
    while substeps < min(most, MAX_SUBSTEPS, longest - 1):
        if share_of_noise(runs, noise, substeps) <= MAX_NOISE:
            break
        if share_of_change(runs, noise, substeps + 1).max() > MAX_CHANGE_THROUGH_NOISE:
            break
        substeps += 1
    return substeps


def fastest_rate(
    step: Callable[[Float[np.ndarray, "N S"]], Float[np.ndarray, "N S"]],
    states: Float[np.ndarray, "N S"],
    dt: float,
) -> float:
    """Return how fast the fastest motion of a step function is [1/s], by the eigenvalues of its step around `states`.

    0 for large systems, of which nobody asks.
    """
    count, size = states.shape
    if size > MAX_STATE:
        return 0.0
    spread = np.maximum(states.std(axis=0), DIFFERENCE)
    slopes = np.zeros((count, size, size))
    for entry in range(size):
        shift = np.zeros(size)
        shift[entry] = DIFFERENCE * spread[entry]
        difference = step(states + shift) - step(states - shift)
        slopes[:, :, entry] = difference / (2 * shift[entry])
    factors = np.linalg.eigvals(slopes[np.isfinite(slopes).all(axis=(1, 2))])
    if not factors.size:
        return 0.0
    sizes = np.maximum(np.abs(factors), MIN_FACTOR)
    rates = np.abs(np.log(sizes) + 1j * np.angle(factors)) / dt
    return float(np.median(rates.max(axis=1)))
