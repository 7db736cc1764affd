"""Where an emulator is weak: conditions under which its error is several times as large as elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.data.readings import Reading, control_readings, state_readings
from neuroanimator.data.spots import find_spots
from neuroanimator.evaluation.component_errors import change_names
from neuroanimator.evaluation.held_out import HeldOut, SuperSteps
from neuroanimator.text import short_number

LOST = 1e3
"""An error that is larger, or no finite number, counts as this [standard deviations of the change]."""

MAX_READINGS = 256
"""So many numbers are looked at for conditions, at most."""

CONTACTS_CHANGE = "contacts made or lost"
"""By how many the contacts at the end of a super step differ from those at its start."""


@dataclass(frozen=True)
class WeakSpot:
    """A condition under which the emulator is weak, measured on unseen runs that had no say in choosing it."""

    condition: str
    """Such as `|hip.velocity| > 8 rad/s`."""
    ratio: float
    """The mean error there over the mean error elsewhere."""
    error: float
    """The mean error there [standard deviations of the change]."""
    share: float
    """Share of the super steps that fulfil the condition."""
    share_of_error: float
    """Share of the sum of all errors that comes from there."""
    component: str
    """What is most wrong there."""

    def __str__(self) -> str:
        """Return it as a sentence."""
        return (
            f"error is {self.ratio:.2g} times that elsewhere where {self.condition} ({self.share:.0%} of samples, "
            f"{self.share_of_error:.0%} of all error), most of all in {self.component}"
        )


@dataclass(frozen=True)
class Outside:
    """The super steps that begin where training showed nothing: the emulator is kept within what it knows."""

    samples: int
    share: float
    """Of all super steps."""
    ratio: float
    """The mean error there over the mean error inside; 0 where there are none."""

    def __str__(self) -> str:
        """Return it as a sentence."""
        if not self.samples:
            return "all unseen runs stay within what training showed"
        return (
            f"{self.samples:,} samples ({self.share:.2g} of all) lie outside of what training showed, and the error there is "
            f"{short_number(self.ratio)} times that inside: generate more, so that the data reach as far as use does"
        )


def outside_of_training(
    is_covered: Bool[np.ndarray, " N"], relative: Float[np.ndarray, "N M"]
) -> Outside:
    """Return how many super steps begin where an emulator is not covered, and how much larger errors are there."""
    errors = step_errors(relative)
    samples = int((~is_covered).sum())
    if not 0 < samples < len(errors):
        return Outside(samples, samples / len(errors), float(samples > 0))
    inside = float(errors[is_covered].mean())
    ratio = float(errors[~is_covered].mean()) / inside if inside > 0 else float("inf")
    return Outside(samples, samples / len(errors), ratio)


def find_weak_spots(
    test: HeldOut,
    steps: SuperSteps,
    relative: Float[np.ndarray, "N M"],
    runs: Int[np.ndarray, " N"],
) -> tuple[WeakSpot, ...]:
    """Return where the errors `relative` (N, M) of super `steps` are large, worst first; each step is of one of `runs`."""
    errors = step_errors(relative)
    names = [name for name, _ in change_names(test.system)]
    moving = [name for name, moves in zip(names, test.moves, strict=True) if moves]
    bounded = np.clip(np.nan_to_num(np.abs(relative), nan=LOST), 0, LOST)
    found = []
    for spot, holds in find_spots(errors, runs, _readings(test, steps)):
        worst = int(np.argmax(np.mean(bounded[holds] ** 2, axis=0)))
        found.append(
            WeakSpot(
                condition=spot.condition,
                ratio=spot.ratio,
                error=spot.mean,
                share=spot.share,
                share_of_error=spot.share_of_total,
                component=moving[worst],
            )
        )
    return tuple(found)


def step_errors(relative: Float[np.ndarray, "N M"]) -> Float[np.ndarray, " N"]:
    """Return one number for each super step: the root mean square over what moves, at most `LOST`."""
    with np.errstate(over="ignore", invalid="ignore"):
        errors = np.sqrt(np.mean(relative**2, axis=1))
    return np.clip(np.nan_to_num(errors, nan=LOST), 0, LOST)


def _readings(test: HeldOut, steps: SuperSteps) -> list[Reading]:
    """Return the numbers that conditions may be made of."""
    system = test.system
    readings = state_readings(system, steps.states) + control_readings(system, steps.controls)
    readings = [reading for reading in readings if reading.can_matter][:MAX_READINGS]
    before = system.contact_counts(steps.states)
    after = system.contact_counts(steps.next_states)
    if before is not None and after is not None:
        readings.append(Reading(CONTACTS_CHANGE, "1", np.abs(after - before).astype(float)))
    return readings
