"""Modes of a body by segments: the position of each segment, and its own deformations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.emulator.mode_fitting import modes_along, shapes_and_flow
from neuroanimator.emulator.pca import Basis, principal, reflection
from neuroanimator.emulator.shape_modes import ShapeModes
from neuroanimator.errors import ArgumentError
from neuroanimator.state.structure import BodyGroup, Structure

Direction = Float[np.ndarray, " D"]
"""Displacement of every mass point in a mode (D = 3 N)."""


class Owner(NamedTuple):
    """The segment that a mode belongs to."""

    group: int
    """Number of the group."""
    is_centre: bool
    """Whether the mode moves the segment as a whole."""


class GroupedModes(NamedTuple):
    """Modes, and the owner of each, in the modes' order; no owners without groups."""

    modes: ShapeModes
    position_owners: list[Owner]
    velocity_owners: list[Owner]


def fit_grouped_modes(
    structure: Structure, states: Float[np.ndarray, "B S"], local: int
) -> GroupedModes:
    """Return modes in which every segment has three for its centre, and `local` more for positions and for velocities."""
    shapes, flow = shapes_and_flow(structure, states)
    positions, position_owners = _grouped(structure, shapes, local)
    velocities, velocity_owners = _grouped(structure, flow, local)
    modes = modes_along(structure, positions, velocities, states)
    return GroupedModes(modes, position_owners, velocity_owners)


def _grouped(
    structure: Structure, vectors: Float[np.ndarray, "B D"], local: int
) -> tuple[Basis, list[Owner]]:
    """Return the directions in which `vectors` (B, 3N) vary, and the owner of each, odd directions first."""
    mean = vectors.mean(axis=0)
    samples = vectors - mean
    reflect = None
    mirrored_mean = mean
    if structure.mirror is not None:
        reflect = reflection(structure.mirror)
        mirrored_mean = (mean + reflect @ mean) / 2
    odd: list[tuple[Direction, Owner]] = []
    even: list[tuple[Direction, Owner]] = []
    for number, group in enumerate(structure.groups):
        rows = np.array([3 * point + axis for point in group.entries for axis in range(3)])
        centre = np.kron(np.ones((len(group.entries), 1)), np.eye(3)) / np.sqrt(len(group.entries))
        own = samples[:, rows] - samples[:, rows] @ centre @ centre.T
        basis = principal(own, min(local, len(rows) - 3), _group_reflection(group, reflect, rows))
        for column, direction in enumerate(basis.directions.T):
            side = odd if column < basis.odd else even
            side.append((_widened(direction, rows, samples), Owner(number, is_centre=False)))
        for axis, direction in enumerate(centre.T):
            is_odd = reflect is None or axis == 1
            side = odd if is_odd else even
            side.append((_widened(direction, rows, samples), Owner(number, is_centre=True)))
    directions, owners = zip(*odd, *even, strict=True)
    return Basis(mirrored_mean, np.stack(directions, axis=1), len(odd)), list(owners)


def _group_reflection(
    group: BodyGroup, reflect: np.ndarray | None, rows: Int[np.ndarray, " G"]
) -> np.ndarray | None:
    """Return the mirror (G, G) within the group's `rows`; ArgumentError if it leads out of the group."""
    if reflect is None:
        return None
    within = reflect[np.ix_(rows, rows)]
    if not np.allclose(within @ within.T, np.eye(len(rows))):
        raise ArgumentError(
            f"groups.{group.name}: it must hold both partners of every pair the mirror swaps."
        )
    return within


def _widened(
    direction: Float[np.ndarray, " G"],
    rows: Int[np.ndarray, " G"],
    samples: Float[np.ndarray, "B D"],
) -> Direction:
    """Return the direction of the whole body that moves only its `rows`, along `direction`."""
    wide = np.zeros(samples.shape[1])
    wide[rows] = direction
    return wide
