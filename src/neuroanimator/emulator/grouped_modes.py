"""Modes of a body part by part: where each segment is, and in which ways it deforms on its own."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from neuroanimator.emulator.modes import RIGID, Modes, fit_modes
from neuroanimator.emulator.principal import principal, reflection
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.structure import Structure


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
    whole = fit_modes(replace(structure, mirror=None), states, 10**6, 10**6)
    inner = whole.encode(np.asarray(states, float))[:, RIGID:]
    size = whole.places.shape[0]
    parts = inner[:, :size] @ np.asarray(whole.places).T, inner[:, size : 2 * size] @ np.asarray(whole.speeds).T
    means = np.asarray(whole.mean_place), np.asarray(whole.mean_speed)
    (places, odd_q, own_q), (speeds, odd_p, own_p) = (_grouped(structure, samples, local) for samples in parts)
    modes = replace(
        whole,
        places=jnp.asarray(places, jnp.float32),
        speeds=jnp.asarray(speeds, jnp.float32),
        mean_place=jnp.asarray(_mirrored_mean(structure, means[0]), jnp.float32),
        mean_speed=jnp.asarray(_mirrored_mean(structure, means[1]), jnp.float32),
        mirror=structure.mirror,
        odd_places=odd_q,
        odd_speeds=odd_p,
    )
    return GroupedModes(modes.with_reach(states), own_q, own_p)


def _mirrored_mean(structure: Structure, mean: np.ndarray) -> np.ndarray:
    return mean if structure.mirror is None else (mean + reflection(structure.mirror) @ mean) / 2


def _grouped(structure: Structure, samples: np.ndarray, local: int) -> tuple[np.ndarray, int, list[Owner]]:
    """Return (directions (3N, K), how many are odd, owners), odd directions first."""
    odd, even = [], []
    reflect = None if structure.mirror is None else reflection(structure.mirror)
    for number, group in enumerate(structure.groups):
        rows = np.array([3 * point + axis for point in group.entries for axis in range(3)])
        centre = np.kron(np.ones((len(group.entries), 1)), np.eye(3)) / np.sqrt(len(group.entries))
        own = samples[:, rows] - samples[:, rows] @ centre @ centre.T
        turned = None if reflect is None else reflect[np.ix_(rows, rows)]
        if turned is not None and not np.allclose(turned @ turned.T, np.eye(len(rows))):
            raise ArgumentError(f"groups.{group.name}: it must hold both partners of every pair the mirror swaps.")
        basis = principal(own, min(local, len(rows) - 3), turned)
        for column, way in enumerate(basis.directions.T):
            (odd if column < basis.odd else even).append((_wide(way, rows, samples), Owner(number, False)))
        for axis, way in enumerate(centre.T):
            is_odd = reflect is None or axis == 1
            (odd if is_odd else even).append((_wide(way, rows, samples), Owner(number, True)))
    ways, owners = zip(*odd, *even, strict=True)
    return np.stack(ways, axis=1), len(odd), list(owners)


def _wide(way: np.ndarray, rows: np.ndarray, samples: np.ndarray) -> np.ndarray:
    wide = np.zeros(samples.shape[1])
    wide[rows] = way
    return wide
