"""How far an emulated body is from the true one after a while: in shape, in position, in orientation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.systems.deformable.deformable_system import DeformableSystem

TEST_SEED = 2**31
"""Test swims are drawn from this seed, one above the largest a dataset may have."""

MIN_DISTANCE = 1e-9
"""Distances travelled count as at least this [m], so that one may divide by them."""


@dataclass(frozen=True)
class Swims:
    """Errors of bodies emulated from the same starts under the same controls as the true ones."""

    shape: Float[np.ndarray, "B T"]
    """Rms distance of mass points, each body seen in its own frame, over the standard deviation of the true shapes."""
    position: Float[np.ndarray, "B T"]
    """Distance of the centroids over the distance the true one has travelled."""
    orientation: Float[np.ndarray, "B T"]
    """Angle between the two [rad]."""
    travelled: Float[np.ndarray, "B T"]
    """The distance the true centroid has travelled [m]."""


def compare_swims(
    emulator: Emulator, system: DeformableSystem, runs: int, steps: int, seed: int = 5
) -> Swims:
    """Return the errors of `runs` random swims of `steps` super steps, unseen in training; T is steps + 1."""
    rng = np.random.default_rng([seed, TEST_SEED])
    starts = sample_starts(system, rng, runs)
    controls = sample_control_runs(rng, runs, steps, emulator.dt, system)
    true = system.simulate(starts, controls, emulator.dt)
    is_whole = ~true.has_diverged
    emulated = emulator.rollout(starts[is_whole], controls[is_whole], may_diverge=True)
    cloud = system.structure.cloud
    assert cloud is not None
    true_points, _, _ = system.unpack(true.states[is_whole])
    emulated_points, _, _ = system.unpack(np.asarray(emulated, float))
    true_centre, true_orientation, true_shape = cloud.own_frame(true_points)
    centre, orientation, shape = cloud.own_frame(emulated_points)
    spread = _rms_distance(true_shape, true_shape.mean(axis=(0, 1)), axis=None)
    moves = np.diff(true_centre, axis=1, prepend=true_centre[:, :1])
    travelled = np.cumsum(np.linalg.norm(moves, axis=2), axis=1)
    cosine = np.clip(np.abs(np.sum(true_orientation * orientation, axis=-1)), 0, 1)
    distance = np.linalg.norm(true_centre - centre, axis=2)
    return Swims(
        shape=_rms_distance(true_shape, shape, axis=-1) / spread,
        position=distance / np.maximum(travelled, MIN_DISTANCE),
        orientation=2 * np.arccos(cosine),
        travelled=travelled,
    )


def _rms_distance(first: np.ndarray, second: np.ndarray, axis: int | None) -> np.ndarray:
    """Return the root of the mean square distance of points (..., N, 3) along `axis`; over all of them if None."""
    squared = np.sum((first - second) ** 2, axis=-1)
    return np.sqrt(np.mean(squared, axis=axis))
