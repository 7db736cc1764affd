"""Controllers stay in bounds, lower J, and swing up the real pendulum."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import (
    Emulator,
    NeuroAnimatorError,
    descend,
    is_upright,
    load_system,
    replay,
    stand_upright,
    synthesise,
)
from neuroanimator.control.descend import pose_problem
from neuroanimator.control.methods import METHODS
from neuroanimator.control.objective import objective_cost
from neuroanimator.control.parameters import EachStep
from neuroanimator.control.refine import transitions_near
from neuroanimator.control.synthesise import synthesise_goal
from neuroanimator.data.transitions import Transitions
from neuroanimator.systems.layout import Bounds

REST = np.zeros(6)


@pytest.mark.parametrize("method", sorted(METHODS))
def test_every_method_lowers_the_cost_within_bounds(method: str, shipped: Emulator):
    objective = stand_upright()
    found = descend(shipped, objective, REST, steps=30, method=method, iterations=20)
    assert found.cost < 0.1 * found.costs[0]
    assert (np.abs(found.controls) <= shipped.identity.bounds.largest).all()
    assert found.seconds < 10


def test_gauss_newton_swings_up_the_true_pendulum_within_twenty_iterations(shipped: Emulator):
    system, objective = load_system("pendulum"), stand_upright()
    found = synthesise(shipped, system, objective, REST, steps=30)
    assert found.descent.iterations <= 20 + 2 * found.corrections
    assert found.descent.seconds < 10
    assert found.refinements == 0
    assert is_upright(found.outcome.physical[-1])
    assert found.outcome.cost_physics == pytest.approx(found.outcome.cost_emulator, abs=5)


def test_a_descent_repeats_to_the_same_bytes(shipped: Emulator):
    first, second = (descend(shipped, stand_upright(), REST, steps=20, iterations=5).controls for _ in range(2))
    assert first.tobytes() == second.tobytes()


def test_tighter_limits_are_kept(shipped: Emulator):
    bounds = Bounds((-10.0, 0.0, -1.5), (10.0, 5.0, 1.5))
    found = descend(shipped, stand_upright(), REST, steps=30, iterations=10, bounds=bounds)
    np.testing.assert_allclose(bounds.clip(found.controls), found.controls, atol=1e-6)


@pytest.mark.parametrize("steps", [4, 10])
def test_the_jacobian_and_the_gradient_agree(steps: int, shipped: Emulator):
    """Few numbers are differentiated at once, many step by step."""
    problem = pose_problem(shipped, stand_upright(), EachStep.of(steps, shipped.identity.bounds), REST)
    z = jnp.asarray(np.random.default_rng(0).normal(size=problem.parameters.size), jnp.float32)
    residuals, jacobian, extra = problem.linearised(z)
    cost, gradient = jax.value_and_grad(problem.cost)(z)
    assert float(cost) == pytest.approx(float(jnp.sum(residuals**2)) / 2, rel=1e-5)
    np.testing.assert_allclose(jacobian.T @ residuals + extra, gradient, rtol=2e-3, atol=1e-4 * np.abs(gradient).max())


def test_the_objective_is_zero_only_for_the_goal_without_effort(shipped: Emulator):
    objective = stand_upright()
    goal, idle = np.array([[np.pi, 0, 0, 0, 0, 0]]), np.zeros((1, 3))
    assert objective_cost(objective, shipped, goal, idle) == pytest.approx(0, abs=1e-9)
    assert objective_cost(objective, shipped, goal, idle + 1) > 0
    assert objective_cost(objective, shipped, goal + 0.01, idle) > 0


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        ([np.pi, 0, 0, 0, 0, 0], True),
        ([-np.pi, 0, 2 * np.pi, 0, 0, 0], True),
        ([np.pi + 0.3, 0, 0, 0, 0, 0], False),
        ([np.pi, 0, 0, 0.6, 0.6, 0], False),
        ([0, 0, 0, 0, 0, 0], False),
    ],
)
def test_upright_means_within_ten_degrees_and_one_radian_a_second(state, expected: bool):
    assert is_upright(np.array(state)) is expected


def test_refining_adds_physics_near_the_motion(shipped: Emulator, transitions: Transitions):
    system = load_system("pendulum")
    controls = descend(shipped, stand_upright(), REST, steps=20, iterations=5).controls
    motion = replay(shipped, system, stand_upright(), REST, controls).physical
    more = transitions_near(transitions, motion, controls, count=200)
    added = slice(len(transitions.states), None)
    assert len(more.states) > len(transitions.states) + 150
    again = system.simulate(more.states[added, 0], more.controls[added], 0.05)
    np.testing.assert_allclose(again.states[:, 1], more.states[added, 1], atol=2e-3)
    assert set(more.run[added]).isdisjoint(transitions.run)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goal": "dance"}, "No goal called 'dance' for the system pendulum. Goals: upright"),
        ({"seconds": 0.0}, "seconds"),
        ({"seconds": float("nan")}, "seconds"),
        ({"effort_weight": -1.0}, "effort_weight"),
        ({"method": "magic"}, "Methods: adam, gauss-newton, lbfgs, momentum"),
        ({"iterations": 0}, "at least 1"),
    ],
)
def test_bad_wishes_are_refused_by_name(options, message: str, shipped: Emulator):
    goal, seconds = options.pop("goal", "upright"), options.pop("seconds", 1.0)
    with pytest.raises(NeuroAnimatorError, match=message):
        synthesise_goal(shipped, goal, seconds, **options)
