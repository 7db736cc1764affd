"""Why an emulator errs: half sentences for its verdict, from its errors on super steps it has not learnt and from its data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.learn.data.shortcomings import shortcomings
from neuroanimator.learn.data.store import Dataset
from neuroanimator.learn.data.stored import SuperSteps
from neuroanimator.learn.evaluation.accuracy import bounded, step_differences, step_errors
from neuroanimator.learn.evaluation.component_errors import (
    ComponentError,
    change_names,
    component_errors,
)
from neuroanimator.learn.evaluation.held_out import HeldOut, make_test
from neuroanimator.learn.evaluation.weakness.conditions import WeakSpot, find_spots
from neuroanimator.learn.evaluation.weakness.readings import (
    Reading,
    control_readings,
    state_readings,
)
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.survey import validation_mask
from neuroanimator.text import short_number

LARGE_PART = 0.5
"""Share of the squared error above which a verdict names where it is."""

MANY_OUTSIDE = 0.05
"""Share of unseen samples outside the training data above which a verdict may say so."""

LARGE_SHARE = 1 / 3
"""Share of the error under one condition above which a verdict may name it: conditions hold for half of the samples at most."""

MUCH_WORSE = 2.0
"""Ratio of the error there to that elsewhere above which it does."""

MAX_READINGS = 256
"""Maximum number of readings in conditions."""

CONTACTS_CHANGE = "contacts made or lost"
"""Name of the reading that counts the contacts made or lost between the ends of a super step."""


@dataclass(frozen=True)
class Extrapolation:
    """The super steps that begin outside the training data: the emulator's inputs are clipped to its range."""

    samples: int
    share: float
    """Share of all super steps."""
    ratio: float
    """Mean error there over the mean error inside; 0 where there are none."""

    def __str__(self) -> str:
        """Return it as a sentence."""
        if not self.samples:
            return "all unseen runs stay within what training showed"
        return (
            f"{self.samples:,} samples ({short_number(100 * self.share)} % of all) lie outside the training data, and the error "
            f"there is {short_number(self.ratio)} times that inside: generate more, so that the data cover what occurs in use"
        )

    @property
    def cause(self) -> str:
        """Half a sentence if many samples lie outside, and are much worse; else nothing."""
        if self.share <= MANY_OUTSIDE or self.ratio <= MUCH_WORSE:
            return ""
        return (
            f"{self.share:.0%} of the unseen samples are outside the training data, with "
            f"{short_number(self.ratio)} times the error"
        )


class StepErrors(NamedTuple):
    """An emulator's errors in single super steps."""

    steps: SuperSteps
    errors: Float[np.ndarray, "N V"]
    """Errors in units of the state."""
    relative: Float[np.ndarray, "N M"]
    """Errors of what moves, over the standard deviation of its change."""
    scores: Float[np.ndarray, " N"]
    """Trust scores."""

    @property
    def is_covered(self) -> Bool[np.ndarray, " N"]:
        """Whether each super step begins within the training data."""
        return self.scores <= EDGE

    @property
    def outside(self) -> Extrapolation:
        """The super steps that begin outside the training data."""
        return outside_of_training(self.is_covered, self.relative)


def errors_of_steps(emulator: Emulator, test: HeldOut) -> StepErrors:
    """Return the errors of `emulator` in the super steps of `test`."""
    steps = test.transitions
    errors = step_differences(emulator, test)
    scores = emulator.trust(steps.states, steps.controls)
    return StepErrors(steps, errors, test.relative(errors), scores)


def outside_of_training(
    is_covered: Bool[np.ndarray, " N"], relative: Float[np.ndarray, "N M"]
) -> Extrapolation:
    """Return the number and share of super steps that begin outside the training data, and the ratio of their errors."""
    errors = step_errors(relative)
    outside = errors[~is_covered]
    share = len(outside) / len(errors)
    if not 0 < share < 1:
        return Extrapolation(len(outside), share, share)
    inside = errors[is_covered].mean()
    ratio = outside.mean() / inside if inside > 0 else np.inf
    return Extrapolation(len(outside), share, float(ratio))


def causes_of(
    found: StepErrors,
    components: Sequence[ComponentError],
    spots: Sequence[WeakSpot],
    data: Dataset | None,
) -> tuple[str, ...]:
    """Return why an emulator errs as in `found`: what its `data` lack, and where the error sits."""
    causes = [] if data is None else shortcomings(data)
    causes += [
        largest_part(components),
        concentrated(spots),
        found.outside.cause,
    ]
    return tuple(cause for cause in causes if cause)


def causes_in_training(
    emulator: Emulator, data: Dataset, config: TrainingConfig
) -> tuple[str, ...]:
    """Return why `emulator` errs on runs of `data` that training by `config` kept for validation."""
    part = data.read_part(0, unroll=1)
    kept = validation_mask(part.run, config)
    # The unit of errors is that of all runs: few may hardly move.
    test = make_test(data.system, emulator.dt, part.states, part.controls)
    test = replace(
        test,
        states=part.states[kept],
        controls=part.controls[kept],
        most_transitions=int(kept.sum()),
    )
    found = errors_of_steps(emulator, test)
    spots = weak_spots(test, found, part.run[kept])
    return causes_of(found, component_errors(test, found.errors), spots, data)


def largest_part(components: Sequence[ComponentError]) -> str:
    """Return half a sentence on the number of the state with most of the error; nothing if none has."""
    squares = [(part.relative or 0.0) ** 2 for part in components]
    total = sum(squares)
    if len(squares) < 2 or not 0 < total < np.inf or max(squares) <= LARGE_PART * total:
        return ""
    most = int(np.argmax(squares))
    return f"{squares[most] / total:.0%} of the error is in {components[most].name}"


def concentrated(spots: Sequence[WeakSpot]) -> str:
    """Return half a sentence on the condition, such as contacts, under which much of the error is; nothing if none is."""
    for spot in spots:
        if spot.share_of_error > LARGE_SHARE and spot.ratio > MUCH_WORSE:
            return f"{spot.share_of_error:.0%} of the error is in the {spot.share:.0%} of samples where {spot.condition}"
    return ""


def weak_spots(
    test: HeldOut, found: StepErrors, runs: Int[np.ndarray, " N"]
) -> tuple[WeakSpot, ...]:
    """Return where the errors `found` are large within the training data; each super step is of one of `runs`."""
    holds = found.is_covered
    known = SuperSteps(*(rows[holds] for rows in found.steps))
    return find_weak_spots(test, known, found.relative[holds], runs[holds])


def find_weak_spots(
    test: HeldOut,
    steps: SuperSteps,
    relative: Float[np.ndarray, "N M"],
    runs: Int[np.ndarray, " N"],
) -> tuple[WeakSpot, ...]:
    """Return where the errors `relative` (N, M) of super `steps` are large, worst first; each step is of one of `runs`."""
    names = np.array([name for name, _ in change_names(test.system)])[test.moves]
    squares = bounded(relative) ** 2
    found = []
    for spot, holds in find_spots(step_errors(relative), runs, _readings(test, steps)):
        worst = int(np.argmax(squares[holds].mean(axis=0)))
        found.append(replace(spot, component=str(names[worst])))
    return tuple(found)


def _readings(test: HeldOut, steps: SuperSteps) -> list[Reading]:
    """Return the readings that conditions may be made of."""
    system = test.system
    readings = state_readings(system, steps.states) + control_readings(system, steps.controls)
    readings = [reading for reading in readings if reading.can_matter][:MAX_READINGS]
    before = system.contact_counts(steps.states)
    after = system.contact_counts(steps.next_states)
    if before is not None and after is not None:
        readings.append(Reading(CONTACTS_CHANGE, "1", np.abs(after - before).astype(float)))
    return readings
