"""Error analysis of an emulator: number by number, condition by condition, by trust, and its worst cases."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.learn.data.config import RUN_STEPS
from neuroanimator.learn.data.store import Dataset
from neuroanimator.learn.evaluation.accuracy import step_errors
from neuroanimator.learn.evaluation.component_errors import (
    ComponentError,
    ErrorSpread,
    component_errors,
    error_spread,
)
from neuroanimator.learn.evaluation.held_out import (
    HELD_OUT_RUNS,
    HeldOut,
    held_out_runs,
    recorded_runs,
    system_of,
)
from neuroanimator.learn.evaluation.trust_bands import TrustBand, trust_bands
from neuroanimator.learn.evaluation.weakness.causes import (
    Extrapolation,
    causes_of,
    errors_of_steps,
    weak_spots,
)
from neuroanimator.learn.evaluation.weakness.conditions import WeakSpot
from neuroanimator.learn.evaluation.weakness.coverage import (
    Coverage,
    as_plain,
    coverage,
    coverage_of_states,
)
from neuroanimator.learn.evaluation.weakness.worst_segments import WorstSegment, worst_segments
from neuroanimator.terminal import phase

INSPECTED_RUNS = 4 * HELD_OUT_RUNS
"""Number of unseen runs inspected: a condition that one super step in twenty fulfils then has 250 of them."""

INSPECTED_SEED = 2**20
"""Seed of the first inspected runs, which differ from those of the figures of `evaluate`."""


@dataclass(frozen=True)
class Inspection:
    """The errors of an emulator on unseen runs, and the conditions under which they are large."""

    system: str
    substeps: int
    dt: float
    runs: int
    samples: int
    """Number of super steps, at most `learn.data.config.RUN_STEPS` of each run."""
    errors: ErrorSpread
    """Distribution of one-step errors over the super steps."""
    components: tuple[ComponentError, ...]
    """The one-step error of every number of the state."""
    weak_spots: tuple[WeakSpot, ...]
    """Conditions under which it is weak within the training data; empty if none was found that holds."""
    outside: Extrapolation
    """The super steps that begin outside the training data."""
    trust: tuple[TrustBand, ...]
    """Errors by the score of `Emulator.trust`; empty for files of versions without one."""
    worst: tuple[WorstSegment, ...]
    """The segments with the largest errors, worst first."""
    coverage: Coverage
    """Coverage of the data; without data, of the inspected runs, which are drawn as data are."""
    has_data: bool
    """Whether `coverage` is that of given data."""
    is_recorded: bool = False
    """Whether the reference is recordings, which hold noise, instead of the teaching physics."""
    causes: tuple[str, ...] = ()
    """Half sentences on why it errs."""

    @property
    def truth_name(self) -> str:
        """Name of the reference in legends."""
        return "recorded" if self.is_recorded else "physics"

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain lists and numbers; worst segments without their states."""
        found = as_plain(self)
        for segment in found["worst"]:
            for name in ("physics", "emulated", "controls", "curves"):
                del segment[name]
        return found


def inspect(
    emulator: Emulator,
    *,
    data: Dataset | None = None,
    runs: int = INSPECTED_RUNS,
    seed: int = 0,
) -> Inspection:
    """Return the errors of `emulator` and where they are large, on `runs` unseen runs drawn from `seed`.

    The reference is the physics that teaches emulators, the system's `truth`. An emulator of recordings is inspected on
    the runs that `data` kept apart.

    Raises ArgumentError where they are missing.
    """
    with phase("simulating"):
        system = system_of(emulator)
        if system.recordings is not None:
            test = recorded_runs(emulator, data)
        else:
            seconds = RUN_STEPS * emulator.dt
            seed = INSPECTED_SEED + seed
            scheme = system.truth
            test = held_out_runs(emulator, count=runs, seconds=seconds, seed=seed, scheme=scheme)
    with phase("inspecting"):
        every = test.states.shape[0] * test.states.shape[1]
        return _inspected(emulator, replace(test, most_transitions=every), data)


def _inspected(emulator: Emulator, test: HeldOut, data: Dataset | None) -> Inspection:
    found = errors_of_steps(emulator, test)
    steps = found.steps
    sizes = step_errors(found.relative)
    components = component_errors(test, found.errors)
    runs = np.arange(len(steps.states)) // (len(steps.states) // len(test.states))
    spots = weak_spots(test, found, runs)
    if data is None:
        covered = coverage_of_states(test.system, steps.states, steps.controls, len(test.states))
    else:
        covered = coverage(data)
    return Inspection(
        system=emulator.system,
        substeps=emulator.substeps,
        dt=emulator.dt,
        runs=len(test.states),
        samples=len(steps.states),
        errors=error_spread(sizes),
        components=components,
        weak_spots=spots,
        outside=found.outside,
        trust=trust_bands(found.scores, sizes) if emulator.meter is not None else (),
        worst=worst_segments(emulator, test),
        coverage=covered,
        has_data=data is not None,
        is_recorded=test.system.recordings is not None,
        causes=causes_of(found, components, spots, data),
    )
