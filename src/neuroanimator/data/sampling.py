"""Starts and controls worth learning from: random and bounded; some runs are idle, some hold their bounds for long."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.state.body_frame import Frame
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

HELD_WARM_UPS = 4.0
"""Maximum time for which controls are held before a run that holds them, in warm-ups: a truck is at its highest speed then."""

IDLE_AMONG_HELD = 0.2
"""Share of the controls of such runs that are idle instead of at a bound: one key is pressed, and not the other."""

GAIT_SHARE = 0.4
"""Share of runs that move by the system's gait, if it has one: faster, slower, weaker, steered."""

FASTER_THAN_GAIT = 1.25
"""Maximum ratio of the frequency of smooth controls to the gait's."""

GAIT_TEMPO = (0.6, 1.4)
"""Minimum and maximum tempo of the gait in random runs, as multiples of its own."""

GAIT_STRENGTH = (0.2, 3.0)
"""Minimum and maximum strength of the gait in random runs, as multiples of its own: the strongest stay at the bounds for
most of a stroke, as optimised ones do, and are the fastest."""

MAX_STEERING = 0.5
"""Maximum offset added to the gait to steer the body, as a share of the controls' range."""

STATE_SPREAD = 0.15
"""Standard deviation of states scattered around a motion, as a share of each entry's spread along it."""

WARM_UP_SUBSTEPS = 50
"""Number of physics steps for which a control is held while a system warms up."""


@runtime_checkable
class Driven(Protocol):
    """A body for which controls are drawn: a system, or an emulator in its place."""

    @property
    def bounds(self) -> Bounds:
        """The bounds of the controls."""
        ...

    @property
    def gait(self) -> Gait | None:
        """Its default gait; None if it has none."""
        ...


def sample_starts(
    system: System, rng: np.random.Generator, count: int, threads: int = 1
) -> Float[np.ndarray, "B S"]:
    """Return `count` random states as they occur in use: some as motions begin, the others after a warm-up."""
    starts = _warmed_up(system, rng, count, threads)
    if system.reset_share > 0:
        is_reset = rng.random(count) < system.reset_share
        starts[is_reset] = system.sample_resets(rng, int(is_reset.sum()))
    return starts


def _warmed_up(
    system: System, rng: np.random.Generator, count: int, threads: int
) -> Float[np.ndarray, "B S"]:
    """Return `count` random starts, each after a random part of the warm-up."""
    starts = system.sample_starts(rng, count)
    if system.warm_up <= 0:
        return starts
    dt = WARM_UP_SUBSTEPS * system.physics_dt
    steps = round(system.warm_up / dt)
    controls = sample_control_runs(rng, count, steps, dt, system)
    return _on_the_way(system, rng, starts, controls, system.rest, threads)


def _on_the_way(
    system: System,
    rng: np.random.Generator,
    starts: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
    instead: Float[np.ndarray, "... S"],
    threads: int,
) -> Float[np.ndarray, "B S"]:
    """Return one of the states of each run of a warm-up, drawn at random; `instead` of those of runs that diverge."""
    count, steps, _ = controls.shape
    dt = WARM_UP_SUBSTEPS * system.physics_dt
    runs = system.simulate(starts, controls, dt, scheme=system.scheme, threads=threads)
    chosen = runs.states[np.arange(count), rng.integers(0, steps + 1, count)]
    return np.where(runs.has_diverged[:, None], instead, chosen)


def sample_control_runs(
    rng: np.random.Generator, count: int, steps: int, dt: float, driven: Driven
) -> Float[np.ndarray, "B T C"]:
    """Return the controls of `count` runs of `driven` over `steps` super steps: its own paths, or those of `sample_controls`."""
    if isinstance(driven, System):
        paths = driven.sample_paths(rng, count, steps, dt)
        if paths is not None:
            return paths
    runs = [sample_controls(rng, steps, dt, driven.bounds, driven.gait) for _ in range(count)]
    return np.stack(runs)


def with_idle_runs(
    rng: np.random.Generator, controls: Float[np.ndarray, "B T C"], bounds: Bounds, share: float
) -> Float[np.ndarray, "B T C"]:
    """Return `controls` with a `share` of the runs idle from a random super step on."""
    count, steps, _ = controls.shape
    ends = np.where(rng.random(count) < share, rng.integers(0, steps, count), steps)
    is_idle = np.arange(steps) >= ends[:, None]
    return np.where(is_idle[..., None], bounds.idle, controls)


def with_held_runs(
    system: System,
    rng: np.random.Generator,
    starts: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
    share: float,
    threads: int = 1,
) -> tuple[Float[np.ndarray, "B S"], Float[np.ndarray, "B T C"]]:
    """Return (starts, controls), a `share` of the runs holding every control at a bound, or idle, for most of the run.

    They hold them before the run already, for up to `HELD_WARM_UPS` times the warm-up, so that data show where a body ends up
    under controls that stay: random ones seldom drive it there. None where outside forces push it: see `System.is_pushed`.
    """
    if system.is_pushed:
        return starts, controls
    count, steps, size = controls.shape
    rows = np.flatnonzero(rng.random(count) < share)
    if not len(rows):
        return starts, controls
    bounds = system.bounds
    signs = np.where(rng.random((len(rows), size)) < 0.5, -1, 1)
    is_idle = rng.random((len(rows), size)) < IDLE_AMONG_HELD
    held = np.where(is_idle, bounds.idle, bounds.middle + signs * bounds.half)[:, None]
    # before the run: from its start under the held controls
    longest = round(HELD_WARM_UPS * system.warm_up / (WARM_UP_SUBSTEPS * system.physics_dt))
    begin = starts[rows]
    if longest:
        held_long = np.repeat(held, longest, axis=1)
        begin = _on_the_way(system, rng, begin, held_long, begin, threads)
    # in the run: until a time in its second half
    until = rng.integers(steps // 2, steps + 1, len(rows))
    is_held = np.arange(steps) < until[:, None]
    starts = starts.copy()
    starts[rows] = begin
    controls = controls.copy()
    controls[rows] = np.where(is_held[..., None], held, controls[rows])
    return starts, controls


def sample_controls(
    rng: np.random.Generator, steps: int, dt: float, bounds: Bounds, gait: Gait | None = None
) -> Float[np.ndarray, "T C"]:
    """Return one run's controls within `bounds`, each of the `steps` entries held for `dt` [s]."""
    if gait is not None and rng.random() < GAIT_SHARE:
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


def runs_near(
    system: System,
    states: Float[np.ndarray, "F S"],
    controls: Float[np.ndarray, "M C"],
    steps: Int[np.ndarray, " N"],
    length: int,
    noise: float,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N T C"]]:
    """Return starts around a motion, and controls of `length` super steps like its own: (F = M+1 states) under `controls`.

    They begin near `steps` (N,), with a spread in proportion to the motion; those near which parts that are tied together
    do not meet begin on it. `noise` of controls is a share of half their range.
    """
    frame = Frame.of(system.structure, 0.0)
    spread = frame.difference(states[:1], states).std(axis=0)
    offsets = rng.normal(size=(len(steps), len(spread))) * STATE_SPREAD * spread
    near, is_closed = system.closed(frame.apply(states[steps], offsets))
    starts = np.where(is_closed[:, None], near, states[steps])
    windows = np.minimum(steps[:, None] + np.arange(length), len(controls) - 1)
    held = controls[windows]
    change = rng.normal(size=held.shape) * noise * system.bounds.half
    return starts, system.bounds.clip(held + change)
