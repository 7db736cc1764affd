"""Baselines lower the true J on the true physics, and their runs are counted honestly."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swing_up import stand_upright
from waiting import PATIENCE

from benchmarks.control.baselines.cost_evaluator import DIVERGED_COST, CostEvaluator
from benchmarks.control.baselines.fast_physics import (
    SINGLE_LANES,
    SimulatedPhysics,
    cheapest_scheme,
    fast_physics,
)
from benchmarks.control.baselines.genetic import MAX_GENE, children_of, winners
from benchmarks.control.baselines.ilqr import linearised
from benchmarks.control.baselines.run_baseline import BASELINES, BaselineRun, run_baseline
from neuroanimator import Emulator, load_system
from neuroanimator.control.descent.parametrisation import EachStep, Spline
from neuroanimator.control.objective.costs import effort
from neuroanimator.control.objective.goals import goal_objective
from neuroanimator.control.objective.objective import Objective, Trajectory
from neuroanimator.control.objective.objective_cost import objective_cost
from neuroanimator.errors import ArgumentError
from neuroanimator.systems.system import Scheme, System

DT = 0.05
PENDULUM = load_system("pendulum")
STEPS = 20
PARAMETERS = EachStep.of(STEPS, PENDULUM.bounds)
UPRIGHT = stand_upright()


def run(name: str, **options) -> BaselineRun:
    settings = {"target": 0.0, "seconds": 2.0, "seed": 1, "scheme": PENDULUM.truth} | options
    return run_baseline(name, PENDULUM, UPRIGHT, PARAMETERS, DT, PENDULUM.rest, **settings)


@pytest.fixture(scope="module")
def first_cost() -> float:
    """J of what every baseline begins with: no control at all."""
    return run("nelder-mead", seconds=0.0).cost


@pytest.mark.parametrize("name", sorted(BASELINES))
def test_every_baseline_lowers_j_on_the_true_pendulum(
    name: str, shipped: Emulator, first_cost: float
):
    found = run(name, target=0.9 * first_cost, seconds=PATIENCE)
    assert found.is_reached
    assert found.cost <= 0.9 * first_cost
    PENDULUM.check_controls(found.controls)
    states = PENDULUM.simulate_fastest(
        PENDULUM.rest[None], found.controls[None], DT, found.scheme
    ).states[0]
    assert found.cost == pytest.approx(
        objective_cost(UPRIGHT, shipped, states, found.controls), rel=1e-5
    )


@pytest.mark.parametrize("name", sorted(BASELINES))
def test_the_same_seed_gives_the_same_run(name: str, first_cost: float):
    first, again = (
        [
            (row.physics_steps, row.cost)
            for row in run(name, target=0.9 * first_cost, seconds=PATIENCE).curve
        ]
        for _ in range(2)
    )
    assert len(first) > 1
    assert first == again


@pytest.mark.parametrize("name", sorted(BASELINES))
def test_a_run_without_time_is_over_after_one_evaluation(name: str):
    found = run(name, seconds=0.0)
    assert found.evaluations == len(found.curve) == 1
    assert found.physics_steps == STEPS * found.scheme.steps(DT)
    assert not found.is_reached
    assert found.reached_seconds is None
    assert found.reached_steps is None


def test_a_run_ends_at_its_target():
    longer = run("ilqr")
    target = longer.curve[len(longer.curve) // 2].cost
    found = run("ilqr", target=target, seconds=30.0)
    assert found.is_reached
    assert found.seconds < 20
    assert found.cost <= target < min(row.cost for row in found.curve[:-1])
    assert found.curve[-1].seconds == found.reached_seconds
    assert found.curve[-1].physics_steps == found.reached_steps == found.physics_steps


def test_curves_fall_while_time_and_physics_steps_rise():
    curve = np.array(
        [
            (row.seconds, row.physics_steps, row.cost)
            for row in run("nelder-mead", seconds=0.5).curve
        ]
    )
    assert (np.diff(curve[:, :2], axis=0) >= 0).all()
    assert (np.diff(curve[:, 2]) < 0).all()


@pytest.mark.parametrize(("name", "steps"), [("pendulum", 10), ("lander", 5)])
def test_the_jacobian_of_ilqr_is_the_finite_difference_of_the_physics(name: str, steps: int):
    """The lander's, high up and turned, shows that changes of quaternions are seen as MuJoCo means them."""
    system = load_system(name)
    dt, start = 50 * system.physics_dt, np.array(system.rest)
    if name == "lander":
        start[2], start[3:7] = start[2] + 10, np.array([0.5, 0.5, 0.5, 0.5])
    goal = UPRIGHT if name == "pendulum" else goal_objective(system, "pad")
    parametrisation = Spline.of(steps, 4, system.bounds)
    physics = fast_physics(system, system.scheme, dt, start, steps)
    evaluator = CostEvaluator(physics, goal, parametrisation, dt, start, system.bounds.magnitude, 1)
    z = np.random.default_rng(0).normal(size=parametrisation.size) * 0.5
    found = linearised(evaluator, z).jacobian
    with jax.enable_x64(True):
        wanted = differences(system, goal, parametrisation, dt, start, z)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() < 1e-3 * np.abs(wanted).max()


def differences(
    system: System,
    goal: Objective,
    parametrisation: Spline,
    dt: float,
    start: np.ndarray,
    z: np.ndarray,
) -> np.ndarray:
    """Return central differences (R, Z) of the residuals on the physics, all in float64."""
    step, limit = 1e-4, jnp.asarray(system.bounds.magnitude)

    def residuals(z: np.ndarray) -> np.ndarray:
        controls = parametrisation.controls(jnp.asarray(z))
        states = system.simulate_fastest(
            start[None], np.asarray(controls)[None], dt, system.scheme
        ).states[0]
        return np.asarray(goal.residuals(Trajectory(jnp.asarray(states), controls, limit, dt)))

    return np.stack(
        [(residuals(z + step * e) - residuals(z - step * e)) / 2 / step for e in np.eye(len(z))],
        axis=1,
    )


def test_a_motion_costs_the_same_alone_and_among_others():
    zs = np.random.default_rng(0).normal(size=(7, PARAMETERS.size))
    physics = fast_physics(PENDULUM, PENDULUM.truth, DT, PENDULUM.rest, STEPS, 8)
    evaluator = CostEvaluator(
        physics, UPRIGHT, PARAMETERS, DT, PENDULUM.rest, PENDULUM.bounds.magnitude, 8
    )
    np.testing.assert_allclose(
        evaluator.costs(zs), [evaluator.costs(z[None])[0] for z in zs], rtol=1e-6
    )


@pytest.mark.parametrize("name", ["pendulum", "pendulum-passive"])
@pytest.mark.parametrize("count", [1, 3])
def test_fast_mujoco_moves_as_the_system_does(name: str, count: int):
    system, rng = load_system(name), np.random.default_rng(0)
    controls = rng.uniform(-1, 1, (count, 6, system.control.size)) * system.bounds.magnitude
    fast = fast_physics(system, system.truth, DT, system.rest, 6, 4)
    slow = SimulatedPhysics(system, system.truth, DT, system.rest, 6, 4)
    for _ in range(2):
        for found, wanted in zip(fast.rollout(controls), slow.rollout(controls), strict=True):
            np.testing.assert_array_equal(found, wanted)


def test_bodies_side_by_side_move_as_by_the_slow_physics():
    cube, rng = load_system("cube"), np.random.default_rng(0)
    controls = rng.uniform(-1, 1, (SINGLE_LANES + 3, 6, cube.control.size)) * cube.bounds.magnitude
    starts = np.repeat(cube.rest[None], len(controls), axis=0)
    slow = cube.simulate(starts, controls, DT, scheme=cube.scheme).states
    fast = fast_physics(cube, cube.scheme, DT, cube.rest, 6, 2 * SINGLE_LANES)
    states, has_diverged = fast.rollout(controls)
    assert has_diverged.shape == (len(controls),)
    assert not has_diverged.any()
    rows = np.moveaxis(states, -1, 1).reshape(-1, *states.shape[1:3])[: len(controls)]
    np.testing.assert_allclose(rows, slow[:, 1:], atol=2e-3)
    np.testing.assert_allclose(fast.rollout(controls[-1:])[0][0, ..., 0], slow[-1, 1:], atol=2e-3)


def test_controls_that_make_the_physics_diverge_cost_most():
    cube = load_system("cube")
    wild = replace(cube.scheme, dt=DT)
    parametrisation = EachStep.of(20, cube.bounds)
    physics = fast_physics(cube, wild, DT, cube.rest, 20, SINGLE_LANES)
    evaluator = CostEvaluator(
        physics,
        Objective.of(effort()),
        parametrisation,
        DT,
        cube.rest,
        cube.bounds.magnitude,
        SINGLE_LANES,
    )
    zs = np.ones((3, parametrisation.size))
    assert cube.simulate_fastest(
        cube.rest[None], evaluator.controls(zs[:1]), DT, wild
    ).has_diverged.all()
    assert (evaluator.costs(zs) == DIVERGED_COST).all()
    assert (evaluator.costs(zs[:1]) == DIVERGED_COST).all()


def test_the_cheapest_scheme_is_one_of_the_two_a_user_would_take():
    assert cheapest_scheme(PENDULUM, DT, PENDULUM.rest) in (PENDULUM.scheme, PENDULUM.truth)
    assert (
        cheapest_scheme(load_system("cube"), DT, load_system("cube").rest)
        == load_system("cube").scheme
    )


def test_ilqr_steps_the_physics_in_a_way_that_mujoco_can_differentiate():
    assert run("ilqr", seconds=0.0, scheme=PENDULUM.truth).scheme == PENDULUM.scheme
    finer = Scheme("implicit", 0.002)
    assert run("ilqr", seconds=0.0, scheme=finer).scheme == finer


def test_unknown_baselines_and_systems_without_derivatives_are_refused_by_name():
    with pytest.raises(
        ArgumentError,
        match="No baseline called 'magic'. Baselines: annealing, cma-es, genetic, ilqr, nelder-mead.",
    ):
        run("magic")
    cube = load_system("cube")
    with pytest.raises(
        ArgumentError, match="ilqr: wanted a MuJoCo system driven by its own motors, got cube."
    ):
        run_baseline(
            "ilqr",
            cube,
            Objective.of(effort()),
            EachStep.of(4, cube.bounds),
            DT,
            cube.rest,
            target=0.0,
            seconds=1.0,
        )


def test_children_stay_within_bounds_and_equal_parents_differ_by_mutation_alone():
    rng = np.random.default_rng(0)
    genes = np.full((200, 30), MAX_GENE)
    children = children_of(genes, np.zeros(200), rng)
    assert children.max() == MAX_GENE
    changed = (children != MAX_GENE).sum(axis=1)
    # Two of a child's genes mutate in the mean; half of these leave the bounds and are brought back.
    assert changed.mean() == pytest.approx(1.0, abs=0.3)


def test_winners_of_tournaments_are_better_than_the_rest():
    costs = np.random.default_rng(0).normal(size=500)
    chosen = winners(costs, np.random.default_rng(1))
    # The least of three is below the median seven times of eight.
    assert (costs[chosen] < np.median(costs)).mean() == pytest.approx(7 / 8, abs=0.06)
