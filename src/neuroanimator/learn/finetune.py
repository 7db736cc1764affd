"""Fine-tune the emulator on the physics around a motion."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from neuroanimator.emulator.description import describe
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.files.unfinished import temporary_folder
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.sampling import runs_near
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK, TrainingConfig
from neuroanimator.learn.training.train import train
from neuroanimator.systems.system import System

CONTROL_SPREAD = 0.15
"""Spread of controls sampled around the motion, as a share of their bounds."""

NEARBY_WINDOWS = 4_000
"""Number of physics windows added per refinement: 0.8 s of data in about two seconds."""

FRESH_TRANSITIONS = 24_000
"""Number of transitions simulated to keep the emulator accurate elsewhere while it learns the motion."""

REFINING_UPDATES = 1_500
"""Number of weight updates of a refinement: seconds, and enough for the neighbourhood of one motion."""

REFINING_RATE = 1e-3
"""Maximum learning rate of a refinement: a tenth of training's, since the weights are nearly right."""

UNROLLED_SHARE = 0.5
"""Share of a refinement's updates that are unrolled over several super steps."""

TRIAL_SHARE = 0.02
"""Share of a refinement's data that is simulated first, to estimate the time for all of it."""

NEARBY_SEED = 7
"""Number joined to that of a refinement as the seed of samples near the motion."""


class OutOfTimeError(Exception):
    """A refinement would take longer than allowed."""

    def __init__(self, seconds: float):
        super().__init__(seconds)
        self.seconds = seconds
        """Approximate time it would take from its beginning [s]."""


class Deadline:
    """Deadline of refinements; those that would not meet it are given up."""

    def __init__(self, seconds: float):
        """Set the deadline `seconds` from now."""
        self._began = time.monotonic()
        self._seconds = seconds

    def check(self, left: float = 0.0) -> None:
        """Raise OutOfTimeError if another `left` [s] would miss the deadline."""
        needed = time.monotonic() - self._began + left
        if needed > self._seconds:
            raise OutOfTimeError(needed)

    def simulated(self, make: Callable[[int], Transitions], count: int) -> Transitions:
        """Return `make(count)`, if a small share of it shows that there is time."""
        make(1)  # loads and compiles, which must not be timed
        began = time.monotonic()
        make(round(TRIAL_SHARE * count))
        self.check((time.monotonic() - began) / TRIAL_SHARE)
        return make(count)

    def watching(self, updates: int) -> Callable[[int], None]:
        """Return a callback that, given the number of updates done, checks whether there is time for all."""
        latest = time.monotonic()

        def on_chunk(done: int) -> None:
            nonlocal latest
            now = time.monotonic()
            if done > UPDATES_PER_CHUNK:  # the first chunk includes compilation
                self.check((now - latest) * (updates - done) / UPDATES_PER_CHUNK)
            latest = now

        return on_chunk


def refined(
    emulator: Emulator,
    system: System,
    data: Transitions | None,
    states: np.ndarray,
    controls: np.ndarray,
    seed: int,
    deadline: Deadline,
) -> tuple[Emulator, Transitions, int]:
    """Return (a copy of the emulator trained further, its data, the number of physics steps).

    The data are `data`, simulated anew if not given, and windows near the motion (T+1, S) under controls (T, C).
    Raises OutOfTimeError if that would miss the `deadline`.
    """

    def fresh(count: int) -> Transitions:
        config = DatasetConfig(
            system=emulator.system,
            definition=emulator.definition,
            substeps=emulator.substeps,
            count=count,
        )
        return simulate_transitions(config)

    known = 0
    if data is None:
        data = deadline.simulated(fresh, FRESH_TRANSITIONS)
    else:
        known = len(data.states)
    old = data

    def near(count: int) -> Transitions:
        return transitions_near(old, states, controls, count=count, seed=seed)

    data = deadline.simulated(near, NEARBY_WINDOWS)
    super_steps = (len(data.states) - known) * (data.states.shape[1] - 1)
    physics_steps = super_steps * system.truth.steps(emulator.dt)
    on_chunk = deadline.watching(REFINING_UPDATES)
    return train_on(emulator, data, on_chunk=on_chunk), data, physics_steps


def train_on(
    emulator: Emulator,
    data: Transitions,
    updates: int = REFINING_UPDATES,
    on_chunk: Callable[[int], None] = lambda update: None,
) -> Emulator:
    """Return a copy of the emulator trained further, for seconds, on `data`; `on_chunk` is called with the updates done."""
    config = TrainingConfig(
        widths=emulator.network.widths,
        network=describe(emulator)["network"]["kind"],
        updates=updates,
        learning_rate=REFINING_RATE,
        unroll_share=UNROLLED_SHARE,
    )
    with temporary_folder() as folder:  # seconds of training: not worth resuming
        path = folder / "refined.emulator.safetensors"
        return train(data, config, path, start_from=emulator, on_chunk=on_chunk)


def transitions_near(
    data: Transitions,
    states: np.ndarray,
    controls: np.ndarray,
    *,
    count: int,
    seed: int = 0,
) -> Transitions:
    """Return `data` plus about `count` physics windows near the motion (T+1, S) under controls (T, C)."""
    system = data.system
    rng = np.random.default_rng([seed, NEARBY_SEED])
    length = system.window_steps
    steps = rng.integers(0, max(1, len(controls) - length + 1), count)
    starts, held = runs_near(system, states, controls, steps, length, CONTROL_SPREAD, rng)
    runs = system.simulate(starts, held, data.config.substeps * system.physics_dt)
    whole = ~runs.has_diverged
    return replace(
        data,
        states=np.concatenate([data.states, runs.states[whole].astype(np.float32)]),
        controls=np.concatenate([data.controls, held[whole].astype(np.float32)]),
        run=np.concatenate([data.run, data.run.max() + 1 + np.flatnonzero(whole)]),
    )
