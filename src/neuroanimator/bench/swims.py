"""How far an emulated body is from the true one after a while: in shape, in place, in heading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.systems.deformable.deformable_system import DeformableSystem


@dataclass(frozen=True)
class Swims:
    """Errors (B, T+1) of bodies emulated from the same starts under the same controls as the true ones."""

    shape: np.ndarray
    """Rms distance of mass points, each body seen in its own frame, over the standard deviation of the true shapes."""
    position: np.ndarray
    """Distance of the centroids over the way the true one has come."""
    orientation: np.ndarray
    """Angle between the two [rad]."""
    way: np.ndarray
    """The way the true centroid has come [m]."""


def compare_swims(
    emulator: Emulator, system: DeformableSystem, runs: int, steps: int, seed: int = 5
) -> Swims:
    """Return the errors of `runs` random swims of `steps` super steps, unseen in training."""
    rng = np.random.default_rng([seed, 2**31])
    starts = sample_starts(system, rng, runs)
    controls = sample_control_runs(rng, runs, steps, emulator.dt, system)
    true = system.simulate(starts, controls, emulator.dt)
    alive = true.is_alive
    found = np.asarray(emulator.rollout(starts[alive], controls[alive], may_diverge=True), float)
    cloud = system.structure.cloud
    assert cloud is not None
    (centre, orientation, seen), (centre_found, turn_found, seen_found) = (
        cloud.own_frame(system.unpack(states)[0]) for states in (true.states[alive], found)
    )
    spread = np.sqrt(np.mean(np.sum((seen - seen.mean(axis=(0, 1))) ** 2, axis=-1)))
    way = np.cumsum(np.linalg.norm(np.diff(centre, axis=1, prepend=centre[:, :1]), axis=2), axis=1)
    cosine = np.clip(np.abs(np.sum(orientation * turn_found, axis=-1)), 0, 1)
    return Swims(
        shape=np.sqrt(np.mean(np.sum((seen - seen_found) ** 2, axis=-1), axis=-1)) / spread,
        position=np.linalg.norm(centre - centre_found, axis=2) / np.maximum(way, 1e-9),
        orientation=2 * np.arccos(cosine),
        way=way,
    )
