"""Whether long rollouts of an emulator stay where the physics stays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.systems.random_controls import sample_control_runs

BLOCK = 500
"""Number of super steps rolled out at once."""

PHYSICS_STARTS = 16
"""Number of runs of the physics that measure its reach in the same time: a lander may fly off at any speed."""

STARTS_SEED = 1
"""Seed of the starts and controls of the emulator's rollouts."""

PHYSICS_SEED = 2
"""Seed of the runs of the physics."""

STILL_REACH = 0.1
"""Reach assumed of a number that never moved [its unit], so that an error of one unit is a divergence."""

TOO_FAR = 10.0
"""Multiple of the reach of training and physics at which a rollout has diverged."""


def count_diverged(
    emulator: Emulator,
    starts: int,
    steps: int,
    *,
    among: Float[np.ndarray, "N S"] | None = None,
) -> int:
    """Return the number of `starts` random starts that get ten times further than training and physics in the same time.

    The starts are the system's own random ones, or drawn from the states `among`. Controls are as
    random and as strong as in training, for `steps` super steps.
    """
    rng = np.random.default_rng(STARTS_SEED)
    if among is None:
        drawn = sample_starts(system_of(emulator), rng, starts, core_count())
    else:
        drawn = rng.choice(among, starts)
    states = np.asarray(drawn, np.float32)
    rest = np.asarray(emulator.rest, np.float32)
    bound = TOO_FAR * np.maximum(reach(emulator, steps), min_reach(emulator))
    is_fine = np.ones(starts, dtype=bool)
    for controls in _control_blocks(emulator, rng, starts, steps):
        # Diverged rollouts go on from rest: their numbers are useless.
        begin = np.where(is_fine[:, None], states, rest)
        path = np.asarray(emulator.rollout(begin, controls, may_diverge=True))
        inputs = np.abs(emulator.raw_features_of(path[:, 1:], controls.astype(np.float32)))
        is_fine &= np.isfinite(path).all(axis=(1, 2))
        is_fine &= (inputs <= bound).all(axis=(1, 2))
        states = path[:, -1]
    return int((~is_fine).sum())


def reach(emulator: Emulator, steps: int) -> Float[np.ndarray, " K"]:
    """Return the largest magnitude of each number the network sees, in training and in `steps` super steps of physics."""
    domain = emulator.domain
    largest = np.maximum(np.abs(np.asarray(domain.low)), np.abs(np.asarray(domain.high)))
    system = system_of(emulator)
    if not system.is_self_contained:
        return largest
    rng = np.random.default_rng(PHYSICS_SEED)
    threads = core_count()
    states = sample_starts(system, rng, PHYSICS_STARTS, threads)
    for controls in _control_blocks(emulator, rng, PHYSICS_STARTS, steps):
        runs = system.simulate(states, controls, emulator.dt, scheme=system.scheme, threads=threads)
        is_whole = ~runs.has_diverged
        inputs = emulator.raw_features_of(runs.states[is_whole, 1:], controls[is_whole])
        largest = np.maximum(largest, np.abs(inputs).max(axis=(0, 1), initial=0))
        states = np.where(is_whole[:, None], runs.states[:, -1], system.rest)
    return largest


def min_reach(emulator: Emulator) -> Float[np.ndarray, " K"]:
    """Return the smallest reach assumed of each number the network sees: above zero for what never moves."""
    low = np.asarray(emulator.domain.low)
    high = np.asarray(emulator.domain.high)
    return np.where(high - low < MIN_CHANGE, STILL_REACH, 0.0)


def _control_blocks(
    emulator: Emulator, rng: np.random.Generator, starts: int, steps: int
) -> Iterator[Float[np.ndarray, "B T C"]]:
    """Yield random controls, at most `BLOCK` super steps at a time, `steps` in all."""
    for first in range(0, steps, BLOCK):
        length = min(BLOCK, steps - first)
        yield sample_control_runs(rng, starts, length, emulator.dt, emulator.spec)
