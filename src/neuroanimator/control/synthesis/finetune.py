"""Teach the emulator the physics around a motion it will be used for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuroanimator.data.config import MAX_UNROLL, DatasetConfig
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.sampling import scattered
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.description import describe
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.body_frame import Frame
from neuroanimator.storage.unfinished import temporary_folder
from neuroanimator.systems.system import System
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.train import train

CONTROL_SPREAD = 0.15
"""Controls are sampled so far around the motion, as a share of their bounds."""

NEARBY_WINDOWS = 4_000
"""Physics windows added per refinement: 0.8 s of data in about two seconds."""

FRESH_TRANSITIONS = 24_000
"""Transitions simulated to keep the rest of the emulator in shape while it learns the motion."""

REFINING_UPDATES = 5_000
"""Weight updates of a refinement: seconds, and enough for what is near one motion."""

REFINING_RATE = 1e-3
"""Highest learning rate of a refinement: a fifth of training's, since the weights are nearly right."""

UNROLLED_SHARE = 0.5
"""Share of a refinement's updates that are unrolled over several super steps."""

NEARBY_SEED = 7
"""Joins the number of a refinement as the seed of what is sampled near the motion."""


def refined(
    emulator: Emulator,
    system: System,
    data: Transitions | None,
    states: np.ndarray,
    controls: np.ndarray,
    seed: int,
) -> tuple[Emulator, Transitions, int]:
    """Return (a copy of the emulator trained on, the data it saw, physics steps taken).

    The data are `data`, simulated anew if not given, and windows near the motion (T+1, S) under controls (T, C).
    """
    known = 0
    if data is None:
        data = simulate_transitions(
            DatasetConfig(
                system=emulator.system,
                definition=emulator.definition,
                substeps=emulator.substeps,
                count=FRESH_TRANSITIONS,
            )
        )
    else:
        known = len(data.states)
    data = transitions_near(data, states, controls, count=NEARBY_WINDOWS, seed=seed)
    super_steps = (len(data.states) - known) * (data.states.shape[1] - 1)
    physics_steps = super_steps * system.truth.steps(emulator.dt)
    return train_on(emulator, data), data, physics_steps


def train_on(emulator: Emulator, data: Transitions, updates: int = REFINING_UPDATES) -> Emulator:
    """Return a copy of the emulator trained on, for seconds, with `data`."""
    config = TrainingConfig(
        widths=emulator.network.widths,
        network=describe(emulator)["network"]["kind"],
        updates=updates,
        learning_rate=REFINING_RATE,
        unroll_share=UNROLLED_SHARE,
    )
    with temporary_folder() as folder:  # seconds of training: not worth resuming
        path = folder / "refined.emulator.safetensors"
        return train(data, config, path, start_from=emulator)


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
    system = data.system
    rng = np.random.default_rng([seed, NEARBY_SEED])
    steps = rng.integers(0, max(1, len(controls) - MAX_UNROLL + 1), count)
    bounds = system.bounds
    starts = scattered(Frame.of(system.structure, 0.0), states, steps, rng)
    windows = np.minimum(steps[:, None] + np.arange(MAX_UNROLL), len(controls) - 1)
    noise = rng.normal(size=(count, MAX_UNROLL, len(bounds.half)))
    held = bounds.clip(controls[windows] + noise * CONTROL_SPREAD * bounds.half)
    runs = system.simulate(starts, held, data.config.substeps * system.physics_dt, threads=threads)
    whole = ~runs.has_diverged
    return replace(
        data,
        states=np.concatenate([data.states, runs.states[whole].astype(np.float32)]),
        controls=np.concatenate([data.controls, held[whole].astype(np.float32)]),
        run=np.concatenate([data.run, data.run.max() + 1 + np.flatnonzero(whole)]),
    )
