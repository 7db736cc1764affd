"""The directions in which samples vary most, each odd or even in a body's mirror."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuroanimator.state.structure import Mirror

LEFT_OUT = 0.04
"""Share of the variation (rms) that modes leave out if their number is not given: about a good emulator's error."""


class Basis(NamedTuple):
    """Orthonormal directions."""

    mean: np.ndarray
    """(D,)"""
    directions: np.ndarray
    """(D, K) odd ones first."""
    odd: int
    """How many are odd."""


def principal(samples: np.ndarray, count: int, reflect: np.ndarray | None) -> Basis:
    """Return the `count` directions in which `samples` (B, D) vary most; each odd or even under `reflect` (D, D).

    A `count` of 0 stands for as many as leave out `LEFT_OUT` of the variation.
    """
    size = samples.shape[1]
    signs, ways = (
        (np.full(size, -1.0), np.eye(size)) if reflect is None else np.linalg.eigh(reflect)
    )
    odd, even = (_leading(samples, ways[:, signs * sign > 0], centred=sign > 0) for sign in (-1, 1))
    if reflect is None:
        odd = _leading(samples, ways, centred=True)
    sizes = np.sort(np.concatenate([odd.sizes, even.sizes]))[::-1]
    if count == 0:
        left = np.sqrt(np.maximum(1 - np.cumsum(sizes) / sizes.sum(), 0))
        count = int(np.argmax(left <= LEFT_OUT)) + 1
    least = sizes[count - 1]
    chosen = [each.ways[:, each.sizes >= least] for each in (odd, even)]
    mean = odd.mean if reflect is None else even.mean
    return Basis(mean, np.concatenate(chosen, axis=1)[:, :count], chosen[0].shape[1])


class _Leading(NamedTuple):
    mean: np.ndarray
    ways: np.ndarray
    sizes: np.ndarray


def _leading(samples: np.ndarray, within: np.ndarray, *, centred: bool) -> _Leading:
    """Return principal directions of `samples` (B, D) within a subspace (D, K), and variances, the largest first."""
    inside = samples @ within
    mean = inside.mean(axis=0) * centred
    sizes, ways = np.linalg.eigh((inside - mean).T @ (inside - mean) / len(samples))
    return _Leading(within @ mean, (within @ ways)[:, ::-1], sizes[::-1])


def reflection(mirror: Mirror) -> np.ndarray:
    """Return the matrix (3N, 3N) that swaps partners and reverses Y."""
    swap = np.eye(len(mirror.points))[list(mirror.points)]
    return np.kron(swap, np.diag([1.0, -1.0, 1.0]))


def mixing(mirror: Mirror) -> tuple[np.ndarray, int]:
    """Return (orthogonal (C, C), how many of its columns are odd): differences of partners, then sums."""
    count = len(mirror.controls)
    odd, even = [], []
    for i, partner in enumerate(mirror.controls):
        unit, other = np.eye(count)[i], np.eye(count)[partner]
        if partner == i:
            even.append(unit)
        elif i < partner:
            odd.append((unit - other) / np.sqrt(2))
            even.append((unit + other) / np.sqrt(2))
    return np.stack([*odd, *even], axis=1), len(odd)
