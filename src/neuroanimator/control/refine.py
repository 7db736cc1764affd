"""Teach the emulator the physics around a motion it will be used for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuroanimator.data.transitions import LONGEST_UNROLL, Transitions

STATE_SPREAD = 0.15
"""How far around the motion to sample, as a share of each state entry's spread along it."""
CONTROL_SPREAD = 0.15
"""The same for controls, as a share of their limits."""


def transitions_near(
    data: Transitions,
    states: np.ndarray,
    controls: np.ndarray,
    *,
    count: int,
    seed: int = 0,
    threads: int = 1,
) -> Transitions:
    """Return `data` plus about `count` physics windows near the motion (T+1, S) under controls (T, C)."""
    system, rng = data.system, np.random.default_rng([seed, 7])
    steps = rng.integers(0, max(1, len(controls) - LONGEST_UNROLL + 1), count)
    limit = system.control_limit
    starts = states[steps] + rng.normal(size=(count, states.shape[1])) * STATE_SPREAD * states.std(axis=0)
    windows = np.minimum(steps[:, None] + np.arange(LONGEST_UNROLL), len(controls) - 1)
    held = controls[windows] + rng.normal(size=(count, LONGEST_UNROLL, len(limit))) * CONTROL_SPREAD * limit
    held = np.clip(held, -limit, limit)
    runs = system.simulate(starts, held, data.config.substeps * system.physics_dt, threads=threads)
    alive = runs.is_alive
    return replace(
        data,
        states=np.concatenate([data.states, runs.states[alive].astype(np.float32)]),
        controls=np.concatenate([data.controls, held[alive].astype(np.float32)]),
        run=np.concatenate([data.run, data.run.max() + 1 + np.flatnonzero(alive)]),
    )
