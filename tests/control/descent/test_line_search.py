"""A line search ends with a step that meets the Wolfe conditions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest

from neuroanimator.control.descent.line_search import FLATTENED, SUFFICIENT_FALL, LineSearch

Curve = tuple[Callable[[float], float], Callable[[float], float]]
"""A function of the step and its derivative."""

CURVES: dict[str, Curve] = {
    "parabola": (lambda t: (t - 2) ** 2, lambda t: 2 * (t - 2)),
    "far away": (lambda t: (t - 300) ** 2, lambda t: 2 * (t - 300)),
    "very near": (lambda t: (t - 1e-2) ** 2, lambda t: 2 * (t - 1e-2)),
    "waves": (lambda t: math.cos(3 * t) - t, lambda t: -3 * math.sin(3 * t) - 1),
    "quartic": (lambda t: (t - 1.5) ** 4, lambda t: 4 * (t - 1.5) ** 3),
    "wall": (
        lambda t: t**2 - t if t < 0.7 else math.inf,
        lambda t: 2 * t - 1 if t < 0.7 else math.nan,
    ),
}


@pytest.mark.parametrize("name", CURVES)
def test_the_step_found_meets_the_wolfe_conditions(name: str):
    cost, slope = CURVES[name]
    search = LineSearch(cost(0.0), slope(0.0), step=1.0)
    step = search.step
    for _ in range(15):
        step = search.step
        search.learn(cost(step), slope(step))
        if search.is_met:
            break
    assert search.is_met
    assert cost(step) <= cost(0.0) + SUFFICIENT_FALL * step * slope(0.0)
    assert slope(step) >= FLATTENED * slope(0.0)


def test_a_parabola_overshot_is_met_at_its_minimum():
    search = LineSearch(1.0, -20.0, step=1.0)
    assert not search.learn((1 - 0.1) ** 2 * 100, 2 * 100 * (1 - 0.1))
    assert search.step == pytest.approx(0.1, abs=0.03)


def test_where_nothing_falls_no_step_is_met():
    search = LineSearch(0.0, -1.0, step=1.0)
    steps = []
    for _ in range(10):
        steps.append(search.step)
        assert not search.learn(1.0, 1.0)
    assert not search.is_met
    assert all(later < earlier for earlier, later in itertools.pairwise(steps))
