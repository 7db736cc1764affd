"""Principal component analysis with a mirror: each direction is odd or even."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.state.structure import Mirror

LEFT_OUT = 0.04
"""Share of the variation (rms) that the default number of modes leaves out: about a good emulator's error."""


class Basis(NamedTuple):
    """Orthonormal directions."""

    mean: Float[np.ndarray, " D"]
    directions: Float[np.ndarray, "D K"]
    """Directions, odd ones first."""
    odd: int
    """Number of odd directions."""


def principal(
    samples: Float[np.ndarray, "B D"], count: int, reflect: Float[np.ndarray, "D D"] | None
) -> Basis:
    """Return the `count` directions in which `samples` (B, D) vary most; each odd or even under `reflect` (D, D).

    Without a mirror all are odd. A `count` of 0 means as many as leave out `LEFT_OUT` of the variation.
    """
    size = samples.shape[1]
    signs = np.full(size, -1.0)
    directions = np.eye(size)
    if reflect is not None:
        signs, directions = np.linalg.eigh(reflect)
    odd = _leading(samples, directions[:, signs < 0], centred=reflect is None)
    even = _leading(samples, directions[:, signs > 0], centred=True)
    variances = np.sort(np.concatenate([odd.variances, even.variances]))[::-1]
    if count == 0:
        left = np.sqrt(np.maximum(1 - np.cumsum(variances) / variances.sum(), 0))
        count = int(np.argmax(left <= LEFT_OUT)) + 1
    least = variances[count - 1]
    chosen_odd = odd.directions[:, odd.variances >= least]
    chosen_even = even.directions[:, even.variances >= least]
    mean = odd.mean if reflect is None else even.mean
    chosen = np.concatenate([chosen_odd, chosen_even], axis=1)[:, :count]
    return Basis(mean, chosen, chosen_odd.shape[1])


class _Leading(NamedTuple):
    """Principal directions, the one of the largest variance first."""

    mean: Float[np.ndarray, " D"]
    directions: Float[np.ndarray, "D K"]
    variances: Float[np.ndarray, " K"]


def _leading(
    samples: Float[np.ndarray, "B D"], within: Float[np.ndarray, "D K"], *, centred: bool
) -> _Leading:
    """Return the principal directions of `samples` (B, D) within a subspace (D, K)."""
    inside = samples @ within
    mean = inside.mean(axis=0) * centred
    variances, directions = np.linalg.eigh((inside - mean).T @ (inside - mean) / len(samples))
    return _Leading(within @ mean, (within @ directions)[:, ::-1], variances[::-1])


def reflection(mirror: Mirror) -> Float[np.ndarray, "D D"]:
    """Return the matrix (3N, 3N) that swaps partners and reverses Y."""
    swap = np.eye(len(mirror.points))[list(mirror.points)]
    return np.kron(swap, np.diag([1.0, -1.0, 1.0]))
