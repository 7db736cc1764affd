"""Controls worth learning from: random, bounded, never idle."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.system import System

SMOOTH_SHARE, HELD_SHARE = 0.6, 0.25
"""Shares of runs with smooth and with held (piecewise constant) controls; the rest jump at every super step."""

WAVES = 3
"""Sinusoids summed in a smooth control."""

FASTEST_WAVE = 1.5
"""[Hz] Motors of arms and muscles of animals seldom reverse faster."""

MIN_SCALE = 0.2
"""Least share of the controls' range a run uses: an idle control teaches nothing."""

MAX_HOLD = 0.6
"""[s] Longest a held control stays."""

GAIT_SHARE = 0.4
"""Share of runs that move along by the system's gait, if it has one: faster, slower, weaker, steered."""
FASTER_THAN_GAIT = 1.25
"""Times the gait's frequency up to which smooth controls go."""
STRONGEST_STEERING = 0.5
"""Of the control's range, added to the gait."""


class Driven(Protocol):
    """What controls are drawn for: a system, or what an emulator stands for."""

    @property
    def bounds(self) -> Bounds:
        """Of the controls."""
        ...

    @property
    def gait(self) -> Gait | None:
        """How it moves along if nothing else is said; None if it has no such way."""
        ...


def sample_starts(
    system: System, rng: np.random.Generator, count: int, threads: int = 1
) -> np.ndarray:
    """Return `count` random states (count, S) as they occur in use: after some warm-up, if the system has one."""
    starts = system.sample_starts(rng, count)
    if system.warm_up <= 0:
        return starts
    dt = WARM_UP_SUBSTEPS * system.physics_dt
    steps = round(system.warm_up / dt)
    controls = sample_control_runs(rng, count, steps, dt, system)
    runs = system.simulate(starts, controls, dt, scheme=system.scheme, threads=threads)
    chosen = runs.states[np.arange(count), rng.integers(0, steps + 1, count)]
    return np.where(runs.is_alive[:, None], chosen, system.rest)


WARM_UP_SUBSTEPS = 50
"""Physics steps a control is held for while warming up."""


def sample_control_runs(
    rng: np.random.Generator, count: int, steps: int, dt: float, driven: Driven
) -> np.ndarray:
    """Return the controls (count, steps, C) of `count` runs of `driven`, see `sample_controls`."""
    return np.stack(
        [sample_controls(rng, steps, dt, driven.bounds, driven.gait) for _ in range(count)]
    )


def with_idle_runs(
    rng: np.random.Generator, controls: np.ndarray, bounds: Bounds, share: float
) -> np.ndarray:
    """Return the controls (B, T, C), a `share` of the runs without control from a random super step on."""
    count, steps, _ = controls.shape
    ends = np.where(rng.random(count) < share, rng.integers(0, steps, count), steps)
    is_idle = np.arange(steps) >= ends[:, None]
    return np.where(is_idle[..., None], bounds.idle, controls)


def sample_controls(
    rng: np.random.Generator, steps: int, dt: float, bounds: Bounds, gait: Gait | None = None
) -> np.ndarray:
    """Return one run's controls (steps, C), each entry held for `dt` [s] and within `bounds`."""
    if gait is not None and rng.random() < GAIT_SHARE:
        return _steered(rng, steps, dt, bounds, gait)
    kind, size = rng.random(), len(bounds.half)
    if kind < SMOOTH_SHARE:
        fastest = (
            FASTEST_WAVE if gait is None else max(FASTEST_WAVE, FASTER_THAN_GAIT / gait.period)
        )
        shape = _smooth(rng, steps, dt, size, fastest)
    elif kind < SMOOTH_SHARE + HELD_SHARE:
        shape = _held(rng, steps, dt, size)
    else:
        shape = rng.uniform(-1, 1, (steps, size))
    return bounds.middle + shape * rng.uniform(MIN_SCALE, 1) * bounds.half


def _steered(
    rng: np.random.Generator, steps: int, dt: float, bounds: Bounds, gait: Gait
) -> np.ndarray:
    """Return the gait at a random tempo and strength, with slow random offsets that steer."""
    start = int(rng.integers(0, max(1, round(gait.period / dt))))
    moves = gait.controls(
        start + steps, dt, bounds, tempo=rng.uniform(0.6, 1.4), strength=rng.uniform(0.2, 1.2)
    )
    offset = _smooth(rng, steps, dt, len(bounds.half), 0.5 / gait.period) * rng.uniform(
        0, STRONGEST_STEERING
    )
    return bounds.clip(moves[start:] + offset * bounds.half)


def _smooth(
    rng: np.random.Generator, steps: int, dt: float, size: int, fastest: float
) -> np.ndarray:
    """Sums of sinusoids, pressed into ±1 so that strong ones saturate as optimised controls do."""
    time = np.arange(steps) * dt
    frequency = rng.uniform(min(0.1, fastest / 2), fastest, (WAVES, 1, size))
    phase = rng.uniform(0, 2 * np.pi, (WAVES, 1, size))
    height = rng.normal(size=(WAVES, 1, size)) * rng.uniform(0.3, 1.5)
    return np.tanh((height * np.sin(2 * np.pi * frequency * time[:, None] + phase)).sum(axis=0))


def _held(rng: np.random.Generator, steps: int, dt: float, size: int) -> np.ndarray:
    hold = int(rng.integers(2, max(3, round(MAX_HOLD / dt) + 1)))
    values = rng.uniform(-1, 1, (steps // hold + 1, size))
    return np.repeat(values, hold, axis=0)[:steps]
