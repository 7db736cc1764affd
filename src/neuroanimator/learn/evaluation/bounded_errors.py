"""Whether the bounds of rollouts' errors hold on unseen runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.error_bounds import USUAL_LEVEL
from neuroanimator.learn.evaluation.held_out import HeldOut

SECONDS = (0.5, 1.0, 2.0)
"""Horizons whose shares are printed [s]."""


@dataclass(frozen=True)
class BoundedErrors:
    """Errors and their bounds on unseen runs, super step by super step, in standard deviations of the usual change."""

    level: float
    """Share of motions that should stay below the bounds."""
    runs: int
    times: Float[np.ndarray, " T"]
    """Time since the start [s]."""
    median: Float[np.ndarray, " T"]
    """Median error."""
    high: Float[np.ndarray, " T"]
    """Quantile `level` of the errors."""
    bound: Float[np.ndarray, " T"]
    """Median of the motions' bounds."""
    covered: Float[np.ndarray, " T"]
    """Share of the motions that stay below their own bounds."""

    def __str__(self) -> str:
        told = []
        for seconds in SECONDS:
            step = int(np.argmin(np.abs(self.times - seconds)))
            told.append(f"{self.covered[step]:.0%} after {self.times[step]:.3g} s")
        return ", ".join(dict.fromkeys(told))


def bounded_errors(
    emulator: Emulator, test: HeldOut, emulated: Float[np.ndarray, "B F S"]
) -> BoundedErrors | None:
    """Return errors and bounds of the `emulated` (B, T+1, S) test runs; None for an emulator without bounds."""
    calibration = emulator.calibration
    if calibration is None:
        return None
    steps = min(calibration.steps, test.controls.shape[1])
    errors = calibration.errors(test.system.structure, test.states, emulated)[:, 1 : steps + 1]
    bounds = emulator.error_bounds(test.states[:, 0], test.controls[:, :steps])
    return BoundedErrors(
        level=USUAL_LEVEL,
        runs=len(errors),
        times=np.arange(1, steps + 1) * emulator.dt,
        median=np.median(errors, axis=0),
        high=np.quantile(errors, USUAL_LEVEL, axis=0),
        bound=np.median(bounds, axis=0),
        covered=np.mean(errors <= bounds, axis=0),
    )
