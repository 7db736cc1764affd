"""Do rollouts stay where physics stays?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.evaluation.accuracy import system_of
from neuroanimator.systems.cores import core_count
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem

BLOCK = 500
"""Super steps rolled out at once."""

PHYSICS_STARTS = 16
"""Runs of the physics that show how far it gets in the same time: a lander may fly off at any speed."""

STILL_REACH = 0.1
"""[of its unit] Reach of what never moved, so that it has blown up where it is off by one whole unit."""

TOO_FAR = 10.0
"""Times the reach of training and physics at which a rollout has blown up."""


def count_blow_ups(
    emulator: Emulator, starts: int, steps: int, seed: int = 1, *, among: np.ndarray | None = None
) -> int:
    """Return how many of `starts` random starts get ten times further than training and physics do in the same time.

    The starts are the system's own random ones, or drawn from the states `among` (N, S). Controls are as
    random and as strong as in training, for `steps` super steps.
    """
    spec, rng = emulator.spec, np.random.default_rng(seed)
    system = system_of(emulator)
    drawn = (
        sample_starts(system, rng, starts, core_count())
        if among is None
        else rng.choice(among, starts)
    )
    states, rest = np.asarray(drawn, np.float32), np.asarray(spec.rest, np.float32)
    bound, fine = (
        TOO_FAR * np.maximum(reach(emulator, steps), least_reach(emulator)),
        np.ones(starts, dtype=bool),
    )
    for block in _control_blocks(emulator, rng, starts, steps):
        path = np.asarray(
            emulator.rollout(np.where(fine[:, None], states, rest), block, may_diverge=True)
        )
        seen = np.abs(emulator.raw_features_of(path[:, 1:], block.astype(np.float32)))
        fine &= np.isfinite(path).all(axis=(1, 2)) & (seen <= bound).all(axis=(1, 2))
        states = path[:, -1]
    return int((~fine).sum())


def reach(emulator: Emulator, steps: int) -> np.ndarray:
    """Return (K,) the largest magnitude of what the network sees, in training and in `steps` super steps of physics."""
    domain, system = emulator.domain, system_of(emulator)
    largest = np.maximum(np.abs(np.asarray(domain.low)), np.abs(np.asarray(domain.high)))
    if not isinstance(system, MujocoSystem | DeformableSystem):
        return largest
    rng, threads = np.random.default_rng(2), core_count()
    states = sample_starts(system, rng, PHYSICS_STARTS, threads)
    for block in _control_blocks(emulator, rng, PHYSICS_STARTS, steps):
        runs = system.simulate(states, block, emulator.dt, scheme=system.scheme, threads=threads)
        seen = emulator.raw_features_of(runs.states[runs.is_alive, 1:], block[runs.is_alive])
        largest = np.maximum(largest, np.abs(seen).max(axis=(0, 1), initial=0))
        states = np.where(runs.is_alive[:, None], runs.states[:, -1], system.rest)
    return largest


def least_reach(emulator: Emulator) -> np.ndarray:
    """Return (K,) what counts as the reach of each number the network sees: more than zero for what never moves."""
    low, high = np.asarray(emulator.domain.low), np.asarray(emulator.domain.high)
    return np.where(high - low < MIN_CHANGE, STILL_REACH, 0.0)


def _control_blocks(
    emulator: Emulator, rng: np.random.Generator, starts: int, steps: int
) -> Iterator[np.ndarray]:
    """Yield random controls (starts, at most BLOCK, C) for `steps` super steps in all."""
    for first in range(0, steps, BLOCK):
        yield sample_control_runs(
            rng, starts, min(BLOCK, steps - first), emulator.dt, emulator.spec
        )
