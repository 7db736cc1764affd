"""Error over number of hidden units of the network of 1998."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

import neuroanimator as na
from classic_cases.lessons import FEATURES, PLAIN, Lesson, random_batches, train_side_by_side
from neuroanimator.evaluation.accuracy import unseen_errors
from neuroanimator.training.optimizer import make_optimizer

Rows = list[dict[str, Any]]

UNITS = (5, 10, 20, 35, 50, 100, 200)
"""Numbers of hidden units."""

INPUTS = {"pendulum": (PLAIN, FEATURES), "dolphin": (PLAIN,)}
"""Inputs tried on each system. The classic network with the mirror answers odd numbers only, of which a dolphin has too few."""

COUNTS = {"pendulum": 60_000, "dolphin": 36_000}
"""Number of transitions of each system."""

UPDATES = {"pendulum": 6_000, "dolphin": 3_000}
"""Number of updates of each training."""

SEEDS = {"pendulum": 5, "dolphin": 3}
"""Number of trainings of each size."""

BATCH = 256
"""Number of transitions in a batch."""

SUBSTEPS = 50
"""Number of physics steps in a super step."""

SECONDS = 1.0
"""Time after which rollouts are compared [s]."""


def unit_rows(system: str, is_quick: bool) -> Rows:
    """Return a row per kind of inputs and number of units, and one of the emulator that ships."""
    rows = []
    units_tried = UNITS[:2] if is_quick else UNITS
    count = 3_600 if is_quick else COUNTS[system]
    lessons = [Lesson.of(system, SUBSTEPS, count, inputs) for inputs in INPUTS[system]]
    for inputs, lesson in zip(INPUTS[system], lessons, strict=True):
        for units in units_tried:
            rows.append(unit_row(lesson, system, inputs, units, is_quick))
    shipped = na.load_emulator(f"{system}-{SUBSTEPS}")
    one_step, after = unseen_errors(shipped, lessons[-1].test, SECONDS)
    widths = "-".join(map(str, shipped.network.widths))
    errors = np.array([[one_step, after]])
    rows.append(_row(system, "ships", widths, errors))
    return rows


def unit_row(
    lesson: Lesson, system: str, inputs: str, units: int, is_quick: bool
) -> dict[str, Any]:
    """Return the errors of networks of so many hidden units."""
    updates = 250 if is_quick else UPDATES[system]
    seeds = 2 if is_quick else SEEDS[system]
    settings = na.TrainingConfig(network="classic", widths=(units,), updates=updates)
    (networks,) = train_side_by_side(
        lesson,
        lesson.network("classic", (units,)),
        make_optimizer(settings),
        random_batches(BATCH, lesson.size),
        (updates,),
        seeds,
    )
    one_step = [lesson.one_step_error(network) for network in networks]
    after = [lesson.error_after(network, SECONDS) for network in networks]
    errors = np.stack([one_step, after], axis=1)
    return _row(system, inputs, str(units), errors)


def _row(system: str, inputs: str, units: str, errors: Float[np.ndarray, "N 2"]) -> dict[str, Any]:
    one_step = errors[:, 0]
    after = errors[:, 1]
    return {
        "system": system,
        "inputs": inputs,
        "units": units,
        "seeds": len(errors),
        "one_step_error": float(np.median(one_step)),
        "one_step_least": float(one_step.min()),
        "one_step_largest": float(one_step.max()),
        "error_1s": float(np.median(after)),
        "error_1s_least": float(after.min()),
        "error_1s_largest": float(after.max()),
    }
