"""J, its slope and its quadratic model agree with each other, alone and side by side; other numbers compile nothing."""

from __future__ import annotations

import logging

import jax
import numpy as np
import pytest
from swing_up import stand_upright

from neuroanimator import DescentOptions, Emulator, descend
from neuroanimator.control.descent.descend import pose_problem
from neuroanimator.control.descent.jax_evaluator import JaxEvaluator
from neuroanimator.control.descent.parametrisation import EachStep
from neuroanimator.control.objective.objective_cost import objective_cost
from neuroanimator.emulator.arrays import as_jax

STEPS = 6
REST = np.zeros(6)
ELSEWHERE = np.array([0.3, -0.2, 0.1, 1.0, 0.0, -1.0])

FEW = 5
"""Of a descent: the objective alone, its quadratic model, J of several z, the controls; and one to spare."""


def evaluator_of(emulator: Emulator, start: np.ndarray, effort_weight: float = 1.0) -> JaxEvaluator:
    objective = stand_upright(effort_weight)
    parametrisation = EachStep.of(STEPS, emulator.bounds)
    return JaxEvaluator(pose_problem(emulator, objective, parametrisation, start))


@pytest.fixture(scope="module")
def evaluator(shipped: Emulator) -> JaxEvaluator:
    return evaluator_of(shipped, REST)


@pytest.fixture(scope="module")
def zs(shipped: Emulator) -> np.ndarray:
    size = EachStep.of(STEPS, shipped.bounds).size
    return np.random.default_rng(0).normal(size=(3, size))


def test_everything_agrees_about_the_cost(
    evaluator: JaxEvaluator, zs: np.ndarray, shipped: Emulator
):
    costs = evaluator.costs(zs)
    np.testing.assert_allclose(evaluator.gradients(zs)[0], costs, rtol=1e-4)
    models = evaluator.quadratic_models(zs)
    np.testing.assert_allclose([model.cost for model in models], costs, rtol=1e-4)
    motion = evaluator.motion(zs[0])
    of_motion = objective_cost(stand_upright(), shipped, motion.states, motion.controls)
    assert of_motion == pytest.approx(costs[0], rel=1e-4)


def test_the_slope_is_that_of_the_quadratic_model(evaluator: JaxEvaluator, zs: np.ndarray):
    _, slopes = evaluator.gradients(zs)
    for slope, model in zip(slopes, evaluator.quadratic_models(zs), strict=True):
        np.testing.assert_allclose(model.slope, slope, atol=1e-3 * np.abs(slope).max())


def test_fewer_rows_than_before_are_the_same_rows(evaluator: JaxEvaluator, zs: np.ndarray):
    costs, slopes = evaluator.gradients(zs)
    fewer_costs, fewer_slopes = evaluator.gradients(zs[:2])
    np.testing.assert_array_equal(fewer_costs, costs[:2])
    np.testing.assert_array_equal(fewer_slopes, slopes[:2])


def test_another_start_and_other_weights_compile_nothing(
    shipped: Emulator, zs: np.ndarray, caplog: pytest.LogCaptureFixture
):
    first = evaluator_of(shipped, REST)
    first.quadratic_models(zs[:1])
    moved = first.at(ELSEWHERE)
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        (from_elsewhere,) = moved.quadratic_models(zs[:1])
        (dearer,) = evaluator_of(shipped, ELSEWHERE, 50.0).quadratic_models(zs[:1])
    assert not compiled_names(caplog)
    assert moved.compile_seconds == 0
    (expected,) = evaluator_of(shipped, ELSEWHERE).quadratic_models(zs[:1])
    np.testing.assert_allclose(from_elsewhere.curvature, expected.curvature)
    assert dearer.cost > from_elsewhere.cost


def compiled_names(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [
        record.message
        for record in caplog.records
        if record.message.startswith("Finished XLA compilation")
    ]


def test_a_first_descent_compiles_few_programs(shipped: Emulator, caplog: pytest.LogCaptureFixture):
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        descend(
            shipped, stand_upright(), np.zeros(6), steps=7, options=DescentOptions(iterations=2)
        )
    assert 1 <= len(compiled_names(caplog)) <= FEW, compiled_names(caplog)


def test_loading_an_emulator_compiles_nothing(caplog: pytest.LogCaptureFixture):
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        Emulator.load("truck-25")
    assert not compiled_names(caplog)


def test_numbers_enter_jax_as_they_are_and_as_a_copy():
    numbers = np.array([1.0, 1e300, -2.5])
    found = as_jax(numbers)
    numbers[:] = 0
    np.testing.assert_array_equal(found, np.array([1.0, np.inf, -2.5], np.float32))
    assert as_jax(found) is found or np.array_equal(as_jax(found), found)
