"""Motions to look at, by the emulator alone."""

from __future__ import annotations

import numpy as np

from neuroanimator.data.sampling import sample_controls
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError

LONGEST = 3600.0
"""[s] Longest random motion; an hour."""


def random_motion(emulator: Emulator, seconds: float, seed: int) -> np.ndarray:
    """Return a trajectory (T+1, S) from a random pose at rest under random, never idle controls."""
    if not emulator.dt <= seconds <= LONGEST:
        raise ArgumentError(f"seconds: wanted between {emulator.dt:g} and {LONGEST:g}, came {seconds:g}.")
    if seed < 0:
        raise ArgumentError(f"seed: wanted 0 or more, came {seed}.")
    rng, identity = np.random.default_rng(seed), emulator.identity
    start = np.zeros(identity.state.size)
    angles = [position for position, _ in identity.rates]
    start[angles] = rng.uniform(-np.pi / 2, np.pi / 2, len(angles))
    steps = int(np.ceil(seconds / emulator.dt - 1e-9))
    controls = sample_controls(rng, steps, emulator.dt, np.array(identity.control_limit))
    return np.asarray(emulator.rollout(start, controls), float)


def controlled_motion(emulator: Emulator, controls: np.ndarray) -> np.ndarray:
    """Return the trajectory (T+1, S) from rest under `controls` (T, C); refuse controls out of bounds."""
    limit = np.array(emulator.identity.control_limit)
    controls = emulator.identity.control.check(controls, "control")
    beyond = np.abs(controls) > limit * (1 + 1e-6)
    if beyond.any():
        step, entry = np.argwhere(beyond)[0]
        raise ArgumentError(
            f"control: {emulator.identity.control.names[entry]} out of bounds at step {step}; "
            f"wanted between {-limit[entry]:g} and {limit[entry]:g}, came {controls[step, entry]:g}."
        )
    return np.asarray(emulator.rollout(np.zeros(emulator.identity.state.size), controls), float)
