"""Why an emulator errs: half sentences for its verdict, from its errors on super steps it has not learnt and from its data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.data.shortcomings import shortcomings
from neuroanimator.data.store import Dataset
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.evaluation.accuracy import next_states, step_errors
from neuroanimator.evaluation.component_errors import ComponentError, component_errors
from neuroanimator.evaluation.held_out import HeldOut, SuperSteps, make_test
from neuroanimator.systems.system import System
from neuroanimator.text import short_number
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.survey import validation_mask

LARGE_PART = 0.5
"""Share of the squared error above which a verdict names where it is."""

MANY_OUTSIDE = 0.05
"""Share of unseen samples outside the training data above which a verdict may say so."""

MUCH_WORSE = 2.0
"""Ratio of the error there to that elsewhere above which it does."""


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
    emulated = next_states(emulator, steps.states, steps.controls)
    errors = test.frame.difference(steps.next_states, emulated)
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
    test: HeldOut,
    found: StepErrors,
    components: Sequence[ComponentError],
    data: Dataset | None,
) -> tuple[str, ...]:
    """Return why an emulator errs as in `found`: what its `data` lack, and where the error sits."""
    causes = [] if data is None else shortcomings(data)
    squares = step_errors(found.relative) ** 2
    causes += [
        largest_part(components),
        at_contacts(test.system, found.steps, squares),
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
    test = replace(test, states=part.states[kept], controls=part.controls[kept])
    found = errors_of_steps(emulator, test)
    return causes_of(test, found, component_errors(test, found.errors), data)


def largest_part(components: Sequence[ComponentError]) -> str:
    """Return half a sentence on the number of the state with most of the error; nothing if none has."""
    squares = [(part.relative or 0.0) ** 2 for part in components]
    total = sum(squares)
    if len(squares) < 2 or not 0 < total < np.inf or max(squares) <= LARGE_PART * total:
        return ""
    most = int(np.argmax(squares))
    return f"{squares[most] / total:.0%} of the error is in {components[most].name}"


def at_contacts(system: System, steps: SuperSteps, squares: Float[np.ndarray, " N"]) -> str:
    """Return half a sentence if most of the squared error is in super steps with contacts, or in which some change."""
    before = system.contact_counts(steps.states)
    after = system.contact_counts(steps.next_states)
    if before is None or after is None:
        return ""
    changing = before != after
    touching = (before > 0) | (after > 0)
    cases = {"that touch something": touching, "in which contacts are made or lost": changing}
    for words, holds in cases.items():
        share = float(holds.mean())
        inside = float(squares[holds].sum())
        elsewhere = float(squares[~holds].sum())
        is_most = inside > LARGE_PART * (inside + elsewhere)
        if is_most and inside * (1 - share) > MUCH_WORSE**2 * elsewhere * share:
            return f"{inside / (inside + elsewhere):.0%} of the error is in the {share:.0%} of samples {words}"
    return ""
