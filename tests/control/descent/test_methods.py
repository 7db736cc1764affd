"""Every method finds the minimum of a function whose minimum is known; momentum and Adam step as optax does."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import optax
import pytest
from jaxtyping import Float

from neuroanimator.control.descent.descend import advance
from neuroanimator.control.descent.evaluator import EmulatedMotion, Evaluator, QuadraticModel
from neuroanimator.control.descent.line_search import FLATTENED, SUFFICIENT_FALL, LineSearch
from neuroanimator.control.descent.methods import (
    ADAM_STEP,
    LINE_SEARCH,
    METHODS,
    MOMENTUM,
    MOMENTUM_STEP,
    damped_steps,
)

SIZE = 6
SPREADS = np.geomspace(1, 30, SIZE)
"""Of the bowl's axes: its curvatures span three decades."""
FLOOR = 0.5
"""J at the bottom: without it a descent would go on for ever, winning a share of ever less."""

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


class Bowl(Evaluator):
    """J = FLOOR + |SPREADS · (z - centre)|² / 2; infinite where z is outside of `wall`."""

    def __init__(self, centre: np.ndarray, wall: float = np.inf):
        self.centre = centre
        self.wall = wall
        self.asked = 0
        """How many gradients were asked for."""

    def costs(self, zs: Float[np.ndarray, "K Z"]) -> Float[np.ndarray, " K"]:
        costs = FLOOR + np.sum((SPREADS * (zs - self.centre)) ** 2, axis=1) / 2
        return np.where(np.abs(zs).max(axis=1) < self.wall, costs, np.nan)

    def gradients(
        self, zs: Float[np.ndarray, "K Z"]
    ) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, "K Z"]]:
        self.asked += len(zs)
        costs = self.costs(zs)
        slopes = SPREADS**2 * (zs - self.centre)
        return costs, np.where(np.isfinite(costs)[:, None], slopes, np.nan)

    def quadratic_models(self, zs: Float[np.ndarray, "K Z"]) -> list[QuadraticModel]:
        costs, slopes = self.gradients(zs)
        curvature = np.diag(SPREADS**2)
        return [
            QuadraticModel(curvature, slope, float(cost))
            for cost, slope in zip(costs, slopes, strict=True)
        ]

    def motion(self, z: Float[np.ndarray, " Z"]) -> EmulatedMotion:
        raise NotImplementedError

    def at(self, start: Float[np.ndarray, " S"]) -> Evaluator:
        raise NotImplementedError


@pytest.fixture
def bowl() -> Bowl:
    return Bowl(np.linspace(-1, 1, SIZE))


@pytest.mark.parametrize(("name", "sweeps"), [("gauss-newton", 4), ("lbfgs", 60), ("adam", 200)])
def test_the_bottom_of_a_bowl_is_found(name: str, sweeps: int, bowl: Bowl):
    method = METHODS[name]
    (found,) = advance(method, bowl, [method.begin(np.zeros(SIZE))], sweeps)
    assert found.first == pytest.approx(bowl.costs(np.zeros((1, SIZE)))[0])
    assert found.least == pytest.approx(FLOOR, rel=1e-2)
    assert found.least == pytest.approx(bowl.costs(found.best[None])[0])


@pytest.mark.parametrize("name", sorted(METHODS))
def test_whether_a_start_is_done_is_pythons_own_truth(name: str, bowl: Bowl):
    method = METHODS[name]
    progress = [method.begin(bowl.centre), method.begin(np.zeros(SIZE))]
    for _ in range(5):
        progress = advance(method, bowl, progress, progress[1].sweeps + 1)
        assert {type(one.is_done) for one in progress} == {bool}


@pytest.mark.parametrize("name", sorted(METHODS))
def test_starts_side_by_side_come_to_what_they_come_to_alone(name: str, bowl: Bowl):
    method = METHODS[name]
    guesses = np.random.default_rng(0).normal(size=(4, SIZE))
    together = advance(method, bowl, [method.begin(z) for z in guesses], 12)
    for z, found in zip(guesses, together, strict=True):
        (alone,) = advance(method, bowl, [method.begin(z)], 12)
        np.testing.assert_allclose(found.best, alone.best, rtol=1e-12)
        assert (found.sweeps, found.is_done) == (alone.sweeps, alone.is_done)


@pytest.mark.parametrize("name", sorted(METHODS))
def test_a_start_that_diverges_ends_and_the_others_go_on(name: str, bowl: Bowl):
    bowl.wall = 3.0
    method = METHODS[name]
    beyond = np.full(SIZE, 10.0)
    lost, found = advance(method, bowl, [method.begin(beyond), method.begin(np.zeros(SIZE))], 8)
    assert lost.is_diverged
    assert lost.is_done
    assert not found.is_diverged
    assert found.least < 0.5 * found.first


def test_backward_sweeps_are_counted_one_a_gradient(bowl: Bowl):
    for name in ("adam", "lbfgs", "momentum"):
        bowl.asked = 0
        method = METHODS[name]
        (found,) = advance(method, bowl, [method.begin(np.ones(SIZE))], 10)
        assert found.sweeps == bowl.asked
        assert found.sweeps <= 10 + LINE_SEARCH


@pytest.mark.parametrize(
    ("name", "theirs"),
    [
        ("adam", optax.adam(ADAM_STEP)),
        (
            "momentum",
            optax.chain(
                optax.normalize_by_update_norm(), optax.sgd(MOMENTUM_STEP, momentum=MOMENTUM)
            ),
        ),
    ],
)
def test_steps_are_those_of_optax(name: str, theirs: optax.GradientTransformation, bowl: Bowl):
    method = METHODS[name]
    ours = method.begin(np.zeros(SIZE))
    z = np.zeros(SIZE, np.float32)
    memory = theirs.init(z)
    for _ in range(10):
        (ours,) = method.iterate(bowl, [ours])
        _, slopes = bowl.gradients(z[None].astype(float))
        update, memory = theirs.update(slopes[0].astype(np.float32), memory, z)
        z = np.asarray(optax.apply_updates(z, update))
        np.testing.assert_allclose(ours.z, z, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_damped_steps_solve_their_equations(dtype: type):
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(9, SIZE))
    curvature = (jacobian.T @ jacobian).astype(dtype)
    slope = rng.normal(size=SIZE)
    dampings = np.array([1e-3, 1.0, 100.0])
    steps = damped_steps(curvature, slope, dampings)
    mean = np.trace(curvature) / SIZE
    for damping, step in zip(dampings, steps, strict=True):
        np.testing.assert_allclose(curvature @ step + damping * mean * step, -slope, atol=1e-4)


def test_where_there_is_no_inverse_the_step_is_not_finite():
    curvature = -np.eye(SIZE)
    assert not np.isfinite(damped_steps(curvature, np.ones(SIZE), np.array([1e-3]))).any()


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
