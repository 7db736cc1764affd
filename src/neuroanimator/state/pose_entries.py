"""State entries of position and heading, for programs that read poses without this package."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.state.segments import Position, Quaternion, Velocity, first_of_each, moves_freely
from neuroanimator.state.structure import Structure

NO_WEIGHT = 1e-9
"""Weight of a mass point below which it is left out."""


def describe_root(structure: Structure) -> dict[str, Any] | None:
    """Return a description of how to read position, velocity, forward and up of the whole body from a state, as JSON.

    A rigid root has three entries from `position` on, its quaternion from `orientation`, its velocity from `velocity`. For
    a body of mass points they are sums over (first of three entries, weight); `forward` and `up` must be normalised.
    None if nothing moves freely.
    """
    if structure.cloud is not None:
        return _points_root(structure)
    if not moves_freely(structure.segments):
        return None
    root = first_of_each(structure.segments)
    return {
        "kind": "free",
        "position": root[Position].entries.start,
        "orientation": root[Quaternion].entries.start,
        "velocity": root[Velocity].entries.start,
    }


def _points_root(structure: Structure) -> dict[str, Any]:
    cloud = structure.cloud
    assert cloud is not None
    shares = np.array(cloud.masses)
    moments = np.array(cloud.positions) * shares[:, None]
    velocities = 3 * cloud.count
    return {
        "kind": "points",
        "position": _weighted(shares, 0),
        "velocity": _weighted(shares, velocities),
        "forward": _weighted(moments[:, 0], 0),
        "up": _weighted(moments[:, 2], 0),
    }


def _weighted(weights: Float[np.ndarray, " N"], first: int) -> list[list[float]]:
    """Return [entry, weight] of each mass point that counts; their entries begin at `first`."""
    rows = []
    for number, weight in enumerate(weights):
        if abs(weight) > NO_WEIGHT:
            rows.append([first + 3 * number, float(weight)])
    return rows
