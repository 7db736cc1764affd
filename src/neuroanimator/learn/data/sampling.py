"""Starts and controls worth learning from: random and bounded; some runs are idle, some hold their bounds for long."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.state.body_frame import Frame
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System

HELD_WARM_UPS = 4.0
"""Maximum time for which controls are held before a run that holds them, in warm-ups: a truck is at its highest speed then."""

IDLE_AMONG_HELD = 0.2
"""Share of the controls of such runs that are idle instead of at a bound: one key is pressed, and not the other."""


STATE_SPREAD = 0.15
"""Standard deviation of states scattered around a motion, as a share of each entry's spread along it."""

WARM_UP_SUBSTEPS = 50
"""Number of physics steps for which a control is held while a system warms up."""


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
