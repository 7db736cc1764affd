"""A verdict's causes: where the error sits, samples outside the training data, angles without their velocities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuroanimator.emulator.verdict import missing_rates
from neuroanimator.evaluation.component_errors import ComponentError, error_spread
from neuroanimator.evaluation.weakness.coverage import Coverage, Divergence
from neuroanimator.evaluation.weakness.inspection import Extrapolation, Inspection


def inspected(relative: list[float], units: list[str], outside: Extrapolation) -> Inspection:
    components = []
    for number, (error, unit) in enumerate(zip(relative, units, strict=True)):
        components.append(ComponentError(f"part[{number}]", unit, error, error, 1.0, error))
    return Inspection(
        system="any",
        substeps=1,
        dt=0.1,
        runs=1,
        samples=5,
        errors=error_spread(np.linspace(0.1, 1, 5)),
        components=tuple(components),
        weak_spots=(),
        outside=outside,
        trust=(),
        worst=(),
        coverage=Coverage("any", 5, 5, 1, (), (), Divergence(0, 0.0, ()), ()),
        has_data=True,
        is_recorded=True,
    )


NONE_OUTSIDE = Extrapolation(0, 0.0, 0.0)


@pytest.mark.parametrize("where", range(4))
def test_the_part_with_most_of_the_error_is_named(where: int):
    relative = [0.1] * 4
    relative[where] = 1.0
    [cause] = inspected(relative, ["m"] * 4, NONE_OUTSIDE).causes
    assert cause == f"97% of the error is in part[{where}]"
    assert not inspected([0.1] * 4, ["m"] * 4, NONE_OUTSIDE).causes


def test_samples_outside_the_training_data_count_if_they_are_many_and_worse():
    alike = inspected([0.1] * 4, ["m"] * 4, Extrapolation(50, 0.2, 3.0))
    assert "20% of the unseen samples are outside the training data" in alike.causes[0]
    assert not replace(alike, outside=Extrapolation(50, 0.2, 1.1)).causes
    assert not replace(alike, outside=Extrapolation(1, 0.01, 9.0)).causes


def test_recorded_angles_without_velocities_are_a_cause():
    assert "angles alone" in inspected([0.1] * 2, ["rad", "m"], NONE_OUTSIDE).causes[0]
    assert not inspected([0.1] * 2, ["rad", "rad/s"], NONE_OUTSIDE).causes
    assert not missing_rates(["m", "m/s"])
