"""Whether error bounds of emulators hold of the real body: the share of unseen windows whose error stays below them.

An emulator has bounds from motions that its training left out, simulated or recorded (`na.fit_error_bounds`). Those of
simulated motions know how far it is off its physics, not how far this is off the world; so there are others, measured on
windows of the training part that it has not learnt from.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from benchmarks.real_recordings.cases import Case, Windows, windows
from benchmarks.real_recordings.errors import TOSS_STEPS
from benchmarks.real_recordings.runs import Run
from neuroanimator import Emulator, UnseenRuns, fit_error_bounds
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.learn.training.error_fitting import with_error_bounds

LEVEL = 0.9
"""Share of motions that bounds promise."""

HORIZONS = (0.25, 0.5, 1.0)
"""Shares are told after these times [s]; of tosses the last one is behind the steps that count."""

BoundedShares = Callable[[Windows], dict[str, float | str]]
"""Returns, of unseen windows, cells of the table: the shares of them that stay below bounds."""

SHARES = tuple(
    f"below_{source}_bounds_{horizon}s"
    for source in ("simulated", "recorded")
    for horizon in HORIZONS
)
"""Names of these cells."""


def bounded_shares(
    case: Case, emulator: Emulator, offsets: Float[np.ndarray, " S"] | float, left_out: list[Run]
) -> BoundedShares:
    """Return the shares of windows below both kinds of bounds, of sensors with these offsets.

    `left_out` are runs of the training part, or their ends, that the emulator has not learnt from: bounds are measured on
    windows that begin at each of their samples, and overlap.
    """
    simulated = fit_error_bounds(emulator, optimised_runs=0)
    known = _counted(case, windows(case, left_out, case.dt))
    runs = super_steps(case, emulator, offsets, known)
    recorded = with_error_bounds(emulator, system_of(emulator).structure, runs)

    def shares(unseen: Windows) -> dict[str, float | str]:
        runs = super_steps(case, emulator, offsets, _counted(case, unseen))
        both = [*_below(simulated, runs), *_below(recorded, runs)]
        return dict(zip(SHARES, both, strict=True))

    return shares


def _counted(case: Case, recorded: Windows) -> Windows:
    """Return windows without what is behind the end of some: of tosses the steps that count, if they last so long."""
    if not case.is_cube:
        return recorded
    states = recorded.states[:, : TOSS_STEPS + 1]
    is_whole = np.isfinite(states).all(axis=(1, 2))
    return Windows(states[is_whole], recorded.controls[is_whole, :TOSS_STEPS], None)


def super_steps(
    case: Case, emulator: Emulator, offsets: Float[np.ndarray, " S"] | float, recorded: Windows
) -> UnseenRuns:
    """Return windows as the emulator has them: whole states at each super step, mean controls in it."""
    samples = round(emulator.dt / case.dt)
    steps = recorded.controls.shape[1] // samples
    measured = recorded.states[:, : steps * samples + 1 : samples]
    count, frames, size = measured.shape
    states = np.tile(emulator.rest, (count, frames, 1))
    states[..., :size] = measured - offsets
    given = recorded.controls.shape[2]
    controls = np.zeros((count, steps, emulator.control.size))
    parts = recorded.controls[:, : steps * samples].reshape(count, steps, samples, given)
    controls[..., :given] = parts.mean(axis=2)
    return UnseenRuns(states, emulator.bounds.clip(controls))


def _below(emulator: Emulator, runs: UnseenRuns) -> list[float | str]:
    """Return the share of runs whose error after each horizon is below its bound; empty text behind the last step."""
    assert emulator.calibration is not None
    starts = runs.states[:, 0]
    motion = emulator.rollout(starts, runs.controls, may_diverge=True)
    structure = system_of(emulator).structure
    errors = emulator.calibration.errors(structure, runs.states, np.asarray(motion, float))
    bounds = emulator.error_bounds(starts, runs.controls, level=LEVEL)
    shares: list[float | str] = []
    for horizon in HORIZONS:
        step = round(horizon / emulator.dt)
        if step > bounds.shape[1]:
            shares.append("")
        else:
            shares.append(float(np.mean(errors[:, step] <= bounds[:, step - 1])))
    return shares
