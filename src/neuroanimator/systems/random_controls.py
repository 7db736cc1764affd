"""Random controls within bounds: smooth, held, jumping, or a gait that is steered."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds
from neuroanimator.state.slowness import slowness
from neuroanimator.systems.system import System

SMOOTH_SHARE = 0.6
"""Share of runs with smooth controls."""

HELD_SHARE = 0.25
"""Share of runs with held (piecewise constant) controls; in the rest they jump at every super step."""

WAVES = 3
"""Number of sinusoids summed in a smooth control."""

MAX_FREQUENCY = 1.5
"""Maximum frequency of smooth controls [Hz]: motors of arms and muscles of animals seldom reverse faster."""

MIN_FREQUENCY = 0.1
"""Minimum frequency of smooth controls [Hz], unless half the highest one is lower still."""

MIN_HEIGHT = 0.3
"""Minimum standard deviation of the waves' amplitudes, before they are squashed into ±1."""

MAX_HEIGHT = 1.5
"""Maximum standard deviation of the waves' amplitudes: such controls saturate as optimised ones do."""

MIN_SCALE = 0.2
"""Minimum share of the controls' range that a run uses: idle controls teach nothing."""

MAX_HOLD = 0.6
"""Maximum time for which a control is held [s]."""

FASTER_THAN_GAIT = 1.25
"""Maximum ratio of the frequency of smooth controls to the gait's."""

GAIT_TEMPO = (0.6, 1.4)
"""Minimum and maximum tempo of the gait in random runs, as multiples of its own."""

GAIT_STRENGTH = (0.2, 3.0)
"""Minimum and maximum strength of the gait in random runs, as multiples of its own: the strongest stay at the bounds for
most of a stroke, as optimised ones do, and are the fastest."""

MAX_STEERING = 0.5
"""Maximum offset added to the gait to steer the body, as a share of the controls' range."""


@runtime_checkable
class ControlledBody(Protocol):
    """A body for which controls are drawn: a system, or an emulator in its place."""

    @property
    def bounds(self) -> Bounds:
        """The bounds of the controls."""
        ...

    @property
    def gait(self) -> Gait | None:
        """Its default gait; None if it has none."""
        ...


def sample_control_runs(
    rng: np.random.Generator, count: int, steps: int, dt: float, driven: ControlledBody
) -> Float[np.ndarray, "B T C"]:
    """Return the controls of `count` runs of `driven` over `steps` super steps: its own paths, or those of `sample_controls`."""
    if isinstance(driven, System):
        paths = driven.sample_paths(rng, count, steps, dt)
        if paths is not None:
            return paths
    runs = [sample_controls(rng, steps, dt, driven.bounds, driven.gait) for _ in range(count)]
    return np.stack(runs)


def sample_controls(
    rng: np.random.Generator, steps: int, dt: float, bounds: Bounds, gait: Gait | None = None
) -> Float[np.ndarray, "T C"]:
    """Return one run's controls within `bounds`, each of the `steps` entries held for `dt` [s]."""
    if gait is not None and rng.random() < gait.share:
        return _steered_gait(rng, steps, dt, bounds, gait)
    draw = rng.random()
    size = len(bounds.half)
    if draw < SMOOTH_SHARE:
        shape = _smooth(rng, steps, dt, size, _max_frequency(gait, dt))
    elif draw < SMOOTH_SHARE + HELD_SHARE:
        shape = _held(rng, steps, dt, size)
    else:
        shape = rng.uniform(-1, 1, (steps, size))
    return bounds.middle + shape * rng.uniform(MIN_SCALE, 1) * bounds.half


def _max_frequency(gait: Gait | None, dt: float) -> float:
    """Return the maximum frequency of smooth controls [Hz] in super steps of `dt` [s]."""
    if gait is None:
        return MAX_FREQUENCY / slowness(dt)
    return max(MAX_FREQUENCY, FASTER_THAN_GAIT / gait.period)


def _steered_gait(
    rng: np.random.Generator, steps: int, dt: float, bounds: Bounds, gait: Gait
) -> Float[np.ndarray, "T C"]:
    """Return the gait at a random tempo and strength, with slow random offsets that steer."""
    start = int(rng.integers(0, max(1, round(gait.period / dt))))
    tempo = rng.uniform(*GAIT_TEMPO)
    strength = rng.uniform(*GAIT_STRENGTH)
    strokes = gait.controls(start + steps, dt, bounds, tempo=tempo, strength=strength)
    waves = _smooth(rng, steps, dt, len(bounds.half), 0.5 / gait.period)
    offset = waves * rng.uniform(0, MAX_STEERING)
    return bounds.clip(strokes[start:] + offset * bounds.half)


def _smooth(
    rng: np.random.Generator, steps: int, dt: float, size: int, max_frequency: float
) -> Float[np.ndarray, "T C"]:
    """Return sums of sinusoids, squashed into ±1 so that strong ones saturate as optimised controls do."""
    time = np.arange(steps) * dt
    min_frequency = min(MIN_FREQUENCY / slowness(dt), max_frequency / 2)
    frequency = rng.uniform(min_frequency, max_frequency, (WAVES, 1, size))
    phase = rng.uniform(0, 2 * np.pi, (WAVES, 1, size))
    height = rng.normal(size=(WAVES, 1, size)) * rng.uniform(MIN_HEIGHT, MAX_HEIGHT)
    waves = height * np.sin(2 * np.pi * frequency * time[:, None] + phase)
    return np.tanh(waves.sum(axis=0))


def _held(rng: np.random.Generator, steps: int, dt: float, size: int) -> Float[np.ndarray, "T C"]:
    """Return values within ±1, each held for the same random number of super steps."""
    hold = int(rng.integers(2, max(3, round(MAX_HOLD * slowness(dt) / dt) + 1)))
    values = rng.uniform(-1, 1, (steps // hold + 1, size))
    return np.repeat(values, hold, axis=0)[:steps]
