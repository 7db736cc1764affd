"""Motions to look at, by the emulator alone."""

from __future__ import annotations

import numpy as np

from neuroanimator.data.sampling import sample_controls
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError

LONGEST = 3600.0
"""[s] Longest random motion; an hour."""


def random_motion(emulator: Emulator, seconds: float, seed: int) -> np.ndarray:
    """Return a trajectory (T+1, S) under random, never idle controls, from rest; free hinges start anywhere.

    With the seed 0, what has a gait moves by it.
    """
    if not emulator.dt <= seconds <= LONGEST:
        raise ArgumentError(f"seconds: wanted between {emulator.dt:g} and {LONGEST:g}, came {seconds:g}.")
    if seed < 0:
        raise ArgumentError(f"seed: wanted 0 or more, came {seed}.")
    rng, identity = np.random.default_rng(seed), emulator.identity
    start = np.array(identity.rest)
    positions = _free_hinges(emulator)
    start[positions] = rng.uniform(-np.pi / 2, np.pi / 2, len(positions))
    steps = int(np.ceil(seconds / emulator.dt - 1e-9))
    if seed == 0 and identity.gait is not None:
        controls = identity.gait.controls(steps, emulator.dt, identity.bounds)
    else:
        controls = sample_controls(rng, steps, emulator.dt, identity.bounds, identity.gait)
    return np.asarray(emulator.rollout(start, controls), float)


def _free_hinges(emulator: Emulator) -> np.ndarray:
    """Return the state entries of hinges that are at 0 at rest; a body of mass points has none."""
    if emulator.modes is not None:
        return np.array([], int)
    angles = np.asarray(emulator.features.angles).any(axis=0) & (np.array(emulator.identity.rest) == 0)
    positions = np.array([position for position, _ in emulator.identity.rates], int)  # int even where there are none
    return np.intersect1d(np.flatnonzero(angles), positions)


def controlled_motion(emulator: Emulator, controls: np.ndarray) -> np.ndarray:
    """Return the trajectory (T+1, S) from rest under `controls` (T, C); refuse controls out of bounds."""
    identity = emulator.identity
    controls = identity.bounds.check(identity.control.check(controls, "control"), identity.control.names)
    return np.asarray(emulator.rollout(np.array(identity.rest), controls), float)
