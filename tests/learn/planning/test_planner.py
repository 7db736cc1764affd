"""Planned again at every super step, the pendulum swings up, stays up and recovers from pushes."""

from __future__ import annotations

import numpy as np
import pytest
from swing_up import is_upright, stand_upright

from neuroanimator import Emulator, NeuroAnimatorError, load_system
from neuroanimator.control.descent.parametrisation import EachStep
from neuroanimator.control.objective.costs import effort
from neuroanimator.control.objective.goals import reach_goal
from neuroanimator.control.objective.objective import Objective
from neuroanimator.learn.planning.planner import Planner, moved_on
from neuroanimator.learn.planning.plants import control_plant
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.goal import Goal
from neuroanimator.systems.plants import EmulatorPlant, PhysicsPlant

STEPS, DT = 20, 0.05
REST = np.zeros(6)
UPRIGHT = np.array([np.pi, 0, 0, 0, 0, 0])
TIGHT = Bounds((-5.0, -2.0, 0.0), (5.0, 2.0, 1.0))
RECOVERY = 40
"""Two seconds."""


def stay_upright(steps: int = STEPS, effort_weight: float = 1.0) -> Objective:
    return stand_upright(effort_weight, DT, tuple(DT * np.arange(1, steps + 1)))


@pytest.fixture(scope="module")
def planner(shipped: Emulator) -> Planner:
    return Planner.of(shipped, stay_upright(), STEPS)


@pytest.fixture(scope="module")
def short(shipped: Emulator) -> Planner:
    """A planner within tighter bounds than the emulator's."""
    return Planner.of(shipped, stay_upright(4), 4, bounds=TIGHT)


@pytest.fixture(scope="module")
def physics() -> PhysicsPlant:
    return PhysicsPlant(load_system("pendulum"), DT)


def push(seed: int) -> np.ndarray:
    """Return a kick of every link by up to 1 rad/s, in the joints' speeds."""
    links = np.random.default_rng(seed).uniform(-1, 1, 3)
    return np.concatenate([np.zeros(3), np.diff(links, prepend=0.0)])


@pytest.mark.parametrize("seed", range(5))
def test_a_pushed_pendulum_recovers_on_the_true_physics_only_if_planned(
    seed: int, planner: Planner, physics: PhysicsPlant
):
    kick = push(seed)
    found = control_plant(
        planner,
        physics,
        UPRIGHT,
        RECOVERY,
        lambda step, state: state + kick if step == 0 else state,
    )
    np.testing.assert_array_equal(found.states[0], UPRIGHT + kick)
    assert is_upright(found.states[-1])
    idle = physics.system.simulate_fastest(found.states[:1], np.zeros((1, RECOVERY, 3)), DT).states[
        0
    ]
    assert not is_upright(idle[-1])


def test_it_swings_up_and_stays_up_under_pushes(planner: Planner, physics: PhysicsPlant):
    kicked = 40
    found = control_plant(
        planner, physics, REST, 80, lambda step, state: state + push(9) if step == kicked else state
    )
    assert is_upright(found.states[kicked - 1])
    assert all(is_upright(state) for state in found.states[-20:])
    assert (np.abs(found.controls) <= planner.emulator.bounds.magnitude).all()


def test_a_plan_follows_the_emulator_and_so_does_the_drive(planner: Planner, shipped: Emulator):
    plan = planner.plan(REST)
    np.testing.assert_allclose(plan.states, shipped.rollout(REST, plan.controls), atol=1e-4)
    plant = EmulatorPlant(shipped)
    np.testing.assert_allclose(plant(REST, plan.controls[0]), plan.states[1], atol=1e-5)
    found = control_plant(planner, plant, REST, 5)
    np.testing.assert_allclose(found.states, shipped.rollout(REST, found.controls), atol=1e-4)


@pytest.mark.parametrize("start", [UPRIGHT + push(0), UPRIGHT + push(1)])
def test_planning_from_the_optimum_changes_nothing(start: np.ndarray, planner: Planner):
    settled = planner.plan(start)
    assert np.abs(settled.controls).max() > 0.5
    for _ in range(30):
        settled = planner.plan(start, settled.controls)
    again = planner.plan(start, settled.controls)
    assert again.cost == pytest.approx(settled.cost, rel=1e-3)
    limit = planner.emulator.bounds.magnitude
    assert (np.abs(again.controls - settled.controls) / limit).max() < 0.01


@pytest.mark.parametrize("start", [REST, UPRIGHT + push(0)])
def test_a_plan_moved_on_is_no_worse_a_beginning_than_none(
    start: np.ndarray, planner: Planner, physics: PhysicsPlant
):
    state, last = start, None
    for _ in range(10):
        plan = planner.plan(state, last)
        assert plan.cost <= planner.plan(state).cost * 1.01
        state, last = physics(state, plan.controls[0]), moved_on(plan.controls)


def test_moving_a_plan_on_holds_its_last_control():
    np.testing.assert_array_equal(moved_on(np.arange(6.0).reshape(3, 2)), [[2, 3], [4, 5], [4, 5]])


def test_another_aim_needs_no_new_planner(short: Planner, shipped: Emulator):
    cheaper = stay_upright(4, effort_weight=100.0)
    turned = short.towards(cheaper).plan(REST)
    fresh = Planner.of(shipped, cheaper, 4, bounds=TIGHT).plan(REST)
    np.testing.assert_allclose(turned.controls, fresh.controls, rtol=1e-4)
    assert np.abs(turned.controls - short.plan(REST).controls).max() > 0.5


def test_other_costs_need_a_new_planner(short: Planner):
    system, goal = load_system("pendulum"), Goal(((0, 1.0),), (0.1,))
    for other in (stay_upright(3), Objective.of(effort(), reach_goal(system, goal))):
        with pytest.raises(NeuroAnimatorError, match="Make a new planner"):
            short.towards(other)


def test_tighter_bounds_are_kept(short: Planner):
    found = short.plan(UPRIGHT + 10 * push(0))
    np.testing.assert_allclose(TIGHT.clip(found.controls), found.controls, atol=1e-6)
    assert np.isclose(np.abs(found.controls - TIGHT.middle), TIGHT.half, rtol=0.1).any()


@pytest.mark.parametrize(
    ("steps", "options", "message"),
    [
        (4, {"method": "magic"}, "Methods: adam, gauss-newton, lbfgs, momentum"),
        (4, {"iterations": 0}, "at least 1"),
        (0, {}, "at least 1"),
        (3, {}, "Make it longer"),
        (4, {"starts": 2}, "starts: wanted 1 to the 1 guesses, got 2"),
        (5, {"parametrisation": 4}, "wanted one of 5 super steps, got 4"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_compiled(
    steps: int, options: dict, message: str, shipped: Emulator
):
    if "parametrisation" in options:
        options = {"parametrisation": EachStep.of(options["parametrisation"], shipped.bounds)}
    with pytest.raises(NeuroAnimatorError, match=message):
        Planner.of(shipped, stay_upright(4), steps, **options)


def test_a_state_that_is_not_finite_is_refused(planner: Planner):
    with pytest.raises(NeuroAnimatorError, match="not finite"):
        planner.plan(REST * np.nan)
