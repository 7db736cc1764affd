"""Modes of a body part by part: where each segment is, and in which ways it deforms on its own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuroanimator.emulator.pca import Basis, principal, reflection
from neuroanimator.emulator.shape_modes import Modes, modes_along, seen_in_frame
from neuroanimator.errors import ArgumentError
from neuroanimator.state.structure import Structure


class Owner(NamedTuple):
    """What a mode belongs to."""

    group: int
    is_centre: bool
    """Whether it moves the segment as a whole."""


class GroupedModes(NamedTuple):
    """Modes, and the segment each belongs to, in the modes' order."""

    modes: Modes
    place_owners: list[Owner]
    speed_owners: list[Owner]


def fit_grouped_modes(structure: Structure, states: np.ndarray, local: int) -> GroupedModes:
    """Return modes in which every segment has its centre's three, and `local` more for places and for speeds."""
    assert structure.cloud is not None
    _, shapes, swings = seen_in_frame(structure.cloud, np.asarray(states, float))
    (positions, own_q), (velocities, own_p) = (
        _grouped(structure, samples, local) for samples in (shapes, swings)
    )
    return GroupedModes(modes_along(structure, positions, velocities, states), own_q, own_p)


def _grouped(structure: Structure, seen: np.ndarray, local: int) -> tuple[Basis, list[Owner]]:
    """Return the directions for what is `seen` (B, 3N), and whose each is, odd directions first."""
    mean = seen.mean(axis=0)
    samples = seen - mean
    odd, even = [], []
    reflect = None if structure.mirror is None else reflection(structure.mirror)
    for number, group in enumerate(structure.groups):
        rows = np.array([3 * point + axis for point in group.entries for axis in range(3)])
        centre = np.kron(np.ones((len(group.entries), 1)), np.eye(3)) / np.sqrt(len(group.entries))
        own = samples[:, rows] - samples[:, rows] @ centre @ centre.T
        turned = None if reflect is None else reflect[np.ix_(rows, rows)]
        if turned is not None and not np.allclose(turned @ turned.T, np.eye(len(rows))):
            raise ArgumentError(
                f"groups.{group.name}: it must hold both partners of every pair the mirror swaps."
            )
        basis = principal(own, min(local, len(rows) - 3), turned)
        for column, way in enumerate(basis.directions.T):
            (odd if column < basis.odd else even).append(
                (_wide(way, rows, samples), Owner(number, False))
            )
        for axis, way in enumerate(centre.T):
            is_odd = reflect is None or axis == 1
            (odd if is_odd else even).append((_wide(way, rows, samples), Owner(number, True)))
    ways, owners = zip(*odd, *even, strict=True)
    mirrored = mean if reflect is None else (mean + reflect @ mean) / 2
    return Basis(mirrored, np.stack(ways, axis=1), len(odd)), list(owners)


def _wide(way: np.ndarray, rows: np.ndarray, samples: np.ndarray) -> np.ndarray:
    wide = np.zeros(samples.shape[1])
    wide[rows] = way
    return wide
