"""Where an emulator is good and where it is weak: number by number, condition by condition, and its worst cases."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from neuroanimator.data.config import RUN_STEPS
from neuroanimator.data.coverage import Coverage, as_plain, coverage, coverage_of_states
from neuroanimator.data.store import Transitions
from neuroanimator.data.stored import StoredTransitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.evaluation.component_errors import (
    ComponentError,
    ErrorSpread,
    component_errors,
    error_spread,
)
from neuroanimator.evaluation.held_out import (
    HELD_OUT_RUNS,
    HeldOut,
    SuperSteps,
    held_out_runs,
    recorded_runs,
    system_of,
)
from neuroanimator.evaluation.trust_bands import TrustBand, trust_bands
from neuroanimator.evaluation.weak_spots import (
    Outside,
    WeakSpot,
    find_weak_spots,
    outside_of_training,
    step_errors,
)
from neuroanimator.evaluation.worst_segments import Segment, worst_segments
from neuroanimator.terminal import phase

INSPECTED_RUNS = 4 * HELD_OUT_RUNS
"""So many unseen runs are inspected: a condition that one super step in twenty fulfils then has 250 of them."""

INSPECTED_SEED = 2**20
"""Runs to inspect are drawn apart from those that the figures of `evaluate` are measured on."""


@dataclass(frozen=True)
class Inspection:
    """Where an emulator is good and where it is weak, on unseen runs."""

    system: str
    substeps: int
    dt: float
    runs: int
    samples: int
    """Super steps, `data.config.RUN_STEPS` at most of each run."""
    errors: ErrorSpread
    """How one-step errors are spread over the super steps."""
    components: tuple[ComponentError, ...]
    """The one-step error of every number of the state."""
    weak_spots: tuple[WeakSpot, ...]
    """Conditions under which it is weak within what training showed; empty if none was found that holds."""
    outside: Outside
    """The super steps that begin where training showed nothing."""
    trust: tuple[TrustBand, ...]
    """How errors grow with the score of `Emulator.trust`; empty for files from before there was one."""
    worst: tuple[Segment, ...]
    """The segments on which it goes furthest astray, worst first."""
    coverage: Coverage
    """What the data cover; without data what the inspected runs do, which are drawn as data are."""
    has_data: bool
    """Whether `coverage` is of data that were given."""
    is_recorded: bool = False
    """Whether it is held against recordings, which hold noise, instead of the physics that teaches."""

    @property
    def truth_name(self) -> str:
        """What it is held against, as legends say it."""
        return "recorded" if self.is_recorded else "physics"

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain lists and numbers; of the worst segments all but their states."""
        found = as_plain(asdict(self))
        for segment in found["worst"]:
            for name in ("physics", "emulated", "controls", "curves"):
                del segment[name]
        return found


def inspect(
    emulator: Emulator,
    *,
    data: Transitions | StoredTransitions | None = None,
    runs: int = INSPECTED_RUNS,
    seed: int = 0,
) -> Inspection:
    """Return where `emulator` is good and where it is weak, on `runs` unseen runs drawn from `seed`.

    It is held against what teaches emulators, the system's `truth`. An emulator of recordings is inspected on what
    `data` kept apart.

    Raises ArgumentError where that is missing.
    """
    with phase("simulating"):
        test = _test(emulator, data, runs, seed)
    with phase("inspecting"):
        return _inspected(emulator, test, data)


def _test(
    emulator: Emulator, data: Transitions | StoredTransitions | None, runs: int, seed: int
) -> HeldOut:
    system = system_of(emulator)
    if system.recordings is not None:
        test = recorded_runs(emulator, data)
    else:
        test = held_out_runs(
            emulator,
            count=runs,
            seconds=RUN_STEPS * emulator.dt,
            seed=INSPECTED_SEED + seed,
            scheme=system.truth,
        )
    return replace(test, most_transitions=test.states.shape[0] * test.states.shape[1])


def _inspected(
    emulator: Emulator, test: HeldOut, data: Transitions | StoredTransitions | None
) -> Inspection:
    steps = test.transitions
    emulated = emulator.rollout(steps.states, steps.controls[:, None], may_diverge=True)[:, 1]
    errors = test.frame.difference(steps.next_states, np.asarray(emulated, float))
    relative = test.relative(errors)
    sizes = step_errors(relative)
    runs = np.arange(len(steps.states)) // (len(steps.states) // len(test.states))
    scores = emulator.trust(steps.states, steps.controls)
    is_covered = scores <= EDGE
    known = SuperSteps(*(rows[is_covered] for rows in steps))
    return Inspection(
        system=emulator.system,
        substeps=emulator.substeps,
        dt=emulator.dt,
        runs=len(test.states),
        samples=len(steps.states),
        errors=error_spread(sizes),
        components=component_errors(test, errors),
        weak_spots=find_weak_spots(test, known, relative[is_covered], runs[is_covered]),
        outside=outside_of_training(is_covered, relative),
        trust=trust_bands(scores, sizes) if emulator.meter is not None else (),
        worst=worst_segments(emulator, test),
        coverage=_coverage(test, data),
        has_data=data is not None,
        is_recorded=test.system.recordings is not None,
    )


def _coverage(test: HeldOut, data: Transitions | StoredTransitions | None) -> Coverage:
    if data is not None:
        return coverage(data)
    steps = test.transitions
    return coverage_of_states(test.system, steps.states, steps.controls, len(test.states))
