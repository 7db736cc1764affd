"""Teach the emulator the physics around a motion it will be used for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuroanimator.data.transitions import LONGEST_UNROLL, Transitions
from neuroanimator.emulator.frame import Frame

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
    bounds = system.bounds
    starts = scattered(Frame.of(system.structure, 0.0), states, steps, rng)
    windows = np.minimum(steps[:, None] + np.arange(LONGEST_UNROLL), len(controls) - 1)
    held = controls[windows] + rng.normal(size=(count, LONGEST_UNROLL, len(bounds.half))) * CONTROL_SPREAD * bounds.half
    held = bounds.clip(held)
    runs = system.simulate(starts, held, data.config.substeps * system.physics_dt, threads=threads)
    alive = runs.is_alive
    return replace(
        data,
        states=np.concatenate([data.states, runs.states[alive].astype(np.float32)]),
        controls=np.concatenate([data.controls, held[alive].astype(np.float32)]),
        run=np.concatenate([data.run, data.run.max() + 1 + np.flatnonzero(alive)]),
    )


def scattered(frame: Frame, states: np.ndarray, steps: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return states (N, S) around those of the motion (T+1, S) at `steps` (N,), spread as the motion itself is."""
    spread = frame.difference(states[:1], states).std(axis=0)
    return frame.apply(states[steps], rng.normal(size=(len(steps), len(spread))) * STATE_SPREAD * spread)
