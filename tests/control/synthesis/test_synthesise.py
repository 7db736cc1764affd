"""Controllers stay in bounds, lower J, and swing up the real pendulum."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swing_up import is_upright, stand_upright

from neuroanimator import (
    DescentOptions,
    Emulator,
    NeuroAnimatorError,
    Objective,
    SearchOptions,
    descend,
    load_emulator,
    load_system,
    replay,
    synthesise,
)
from neuroanimator.cli.main_job import CORRECTIONS, SWEEPS
from neuroanimator.control.descent import descend as descend_module
from neuroanimator.control.descent.defects import find_defects
from neuroanimator.control.descent.descend import guesses_around, pose_problem
from neuroanimator.control.descent.methods import METHODS
from neuroanimator.control.descent.parametrisation import EachStep
from neuroanimator.control.objective.costs import (
    effort,
    keep_speed,
    reach_position,
    reach_positions,
    smoothness,
)
from neuroanimator.control.objective.goals import reach_goal
from neuroanimator.control.objective.objective_cost import objective_cost
from neuroanimator.control.synthesis.attempt import CORRECTING_ITERATIONS, Search, make_attempt
from neuroanimator.control.synthesis.replay import LARGE_GAP
from neuroanimator.control.synthesis.summary import outcome_rows, warnings_of
from neuroanimator.control.synthesis.synthesise import restart, synthesise_goal
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.finetune import transitions_near
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.goal import Goal

REST = np.zeros(6)


@pytest.mark.parametrize("method", sorted(METHODS))
def test_every_method_lowers_the_cost_within_bounds(method: str, shipped: Emulator):
    objective = stand_upright()
    found = descend(
        shipped, objective, REST, steps=30, options=DescentOptions(method=method, iterations=20)
    )
    assert found.cost < 0.1 * found.costs[0]
    assert (np.abs(found.controls) <= shipped.bounds.magnitude).all()
    assert found.seconds < 10


def test_the_demos_swing_up_takes_twenty_iterations_at_most_corrections_counted(shipped: Emulator):
    options = SearchOptions(DescentOptions(iterations=SWEEPS), corrections=CORRECTIONS)
    found = synthesise_goal(shipped, load_system("pendulum"), "upright", options=options)
    assert SWEEPS + CORRECTING_ITERATIONS * CORRECTIONS == 20
    assert found.spent.iterations <= 20
    assert found.is_reached


def test_gauss_newton_swings_up_the_true_pendulum_within_twenty_iterations(shipped: Emulator):
    system, objective = load_system("pendulum"), stand_upright()
    found = synthesise(shipped, system, objective, REST, steps=30)
    assert found.spent.iterations <= 20 + 2 * found.spent.corrections
    assert found.spent.seconds < 10
    assert found.spent.refinements == 0
    assert is_upright(found.outcome.physics_states[-1])
    assert found.outcome.cost_physics == pytest.approx(found.outcome.cost_emulator, abs=5)


def test_a_descent_repeats_to_the_same_bytes(shipped: Emulator):
    first, second = (
        descend(
            shipped, stand_upright(), REST, steps=20, options=DescentOptions(iterations=5)
        ).controls
        for _ in range(2)
    )
    assert first.tobytes() == second.tobytes()


def test_tighter_limits_are_kept(shipped: Emulator):
    bounds = Bounds((-10.0, 0.0, -1.5), (10.0, 5.0, 1.5))
    found = descend(
        shipped,
        stand_upright(),
        REST,
        steps=30,
        options=DescentOptions(iterations=10, bounds=bounds),
    )
    np.testing.assert_allclose(bounds.clip(found.controls), found.controls, atol=1e-6)


def bend_the_arm() -> Objective:
    """Return an objective for one number alone, with effort and smoothness."""
    system = load_system("pendulum")
    bent = reach_goal(system, Goal(((1, 0.5),), (0.1,)))
    return Objective.of(effort(0.1), smoothness(0.1), bent)


@pytest.mark.parametrize(
    ("steps", "objective"), [(4, stand_upright()), (10, stand_upright()), (4, bend_the_arm())]
)
def test_the_jacobian_and_the_gradient_agree(steps: int, objective: Objective, shipped: Emulator):
    """Few numbers are differentiated at once, many step by step, and what looks at few numbers is pulled back."""
    problem = pose_problem(shipped, objective, EachStep.of(steps, shipped.bounds), REST)
    z = jnp.asarray(np.random.default_rng(0).normal(size=problem.parametrisation.size), jnp.float32)
    residuals, jacobian, slope, here = eqx.filter_jit(problem.linearised)(z)
    cost, gradient = jax.jit(jax.value_and_grad(problem.cost))(z)
    assert float(cost) == pytest.approx(float(here), rel=1e-5)
    np.testing.assert_allclose(
        jacobian.T @ residuals + slope, gradient, rtol=2e-3, atol=1e-4 * np.abs(gradient).max()
    )


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
    controls = descend(
        shipped, stand_upright(), REST, steps=20, options=DescentOptions(iterations=5)
    ).controls
    motion = replay(shipped, system, stand_upright(), REST, controls).physics_states
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
    ],
)
def test_bad_arguments_are_refused_by_name(options, message: str, shipped: Emulator):
    goal, seconds = options.pop("goal", "upright"), options.pop("seconds", 1.0)
    with pytest.raises(NeuroAnimatorError, match=message):
        synthesise_goal(shipped, load_system("pendulum"), goal, seconds, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "magic"}, "Methods: adam, gauss-newton, lbfgs, momentum"),
        ({"iterations": 0}, "iterations and starts: wanted at least 1, got 0 and 1"),
        ({"starts": 0}, "iterations and starts: wanted at least 1, got 18 and 0"),
        ({"starts": 3, "first": np.zeros((2, 20, 3))}, "3 starts, got 2"),
    ],
)
def test_bad_options_are_refused_where_they_are_made(options, message: str):
    with pytest.raises(NeuroAnimatorError, match=message):
        DescentOptions(**options)


def test_what_no_motion_can_reach_is_refused_before_any_descent(shipped: Emulator):
    fish, system = load_emulator("fish-50"), load_system("fish")
    for term in (
        reach_position(system, [30.0, 0, 0], within=0.1),
        keep_speed(system, 5.0, within=0.1),
        reach_positions(system, [[1.0, 0, 0]], [0.2], within=0.1),
    ):
        with pytest.raises(NeuroAnimatorError, match="training reached 0.185 m/s at most"):
            descend(fish, Objective.of(term), system.rest, steps=10)
    wild = stand_upright()
    goal = np.array(wild.terms[1].goal)
    goal[3] = 500.0
    with pytest.raises(NeuroAnimatorError, match="outside what the emulator was trained on"):
        descend(shipped, eqx.tree_at(lambda o: o.terms[1].goal, wild, goal), REST, steps=10)


@pytest.mark.parametrize("name", ["truck-50", "lander-50"])
def test_velocities_are_found_in_what_the_network_sees(name: str):
    emulator = load_emulator(name)
    kinds = [segment.kind for segment in emulator.frame.segments]
    first = sum(segment.size for segment in emulator.frame.segments[: kinds.index("velocity")])
    before, after = emulator.rest, emulator.rest
    after[first : first + 3] += [1.0, 2.0, 3.0]
    is_velocity = [name == "velocity" for name in emulator.frame.local_names]
    seen = [np.asarray(emulator.frame.local(state))[is_velocity] for state in (before, after)]
    np.testing.assert_allclose(seen[1] - seen[0], [1, 2, 3], atol=1e-5)


def test_corrected_the_emulator_follows_the_physics_exactly(shipped: Emulator):
    system, rng = load_system("pendulum"), np.random.default_rng(0)
    controls = rng.uniform(-1, 1, (20, 3)) * system.bounds.half
    states = system.simulate(REST[None], controls[None], shipped.dt).states[0]
    problem = pose_problem(shipped, stand_upright(), EachStep.of(20, system.bounds), REST)
    plain = np.abs(np.asarray(shipped.rollout(REST, controls)) - states).max()
    defects = find_defects(shipped, states, controls)
    held = eqx.tree_at(lambda p: p.defects, problem, defects)
    z = jnp.asarray(held.parametrisation.guess(controls), jnp.float32)
    corrected = np.abs(np.asarray(held.trajectory(z).states) - states).max()
    assert corrected < 0.01 * plain


def test_several_first_guesses_are_never_worse_than_one(shipped: Emulator):
    one, several = (
        descend(shipped, stand_upright(), REST, steps=20, options=DescentOptions(starts=k))
        for k in (1, 3)
    )
    assert several.cost <= one.cost * (1 + 1e-3)
    assert len(several.candidates) == 3
    assert (np.diff(several.candidate_costs) >= 0).all()


@pytest.mark.parametrize("method", sorted(METHODS))
def test_the_first_cost_is_that_of_the_first_guess(method: str, shipped: Emulator):
    controls = np.full((20, 3), 0.5)
    found = descend(
        shipped,
        stand_upright(),
        REST,
        steps=20,
        options=DescentOptions(iterations=2, method=method, first=controls),
    )
    emulator_states = np.asarray(shipped.rollout(REST, controls))
    assert found.costs[0] == pytest.approx(
        objective_cost(stand_upright(), shipped, emulator_states, controls), rel=1e-3
    )


def test_beginning_again_never_ends_worse_and_is_charged(shipped: Emulator):
    system = load_system("pendulum")
    plain = SearchOptions(DescentOptions(iterations=3), corrections=0, refinements=0)
    restarted = replace(plain, restarts=2)
    once, again = (
        synthesise(shipped, system, stand_upright(), REST, steps=20, options=options)
        for options in (plain, restarted)
    )
    assert again.outcome.cost_physics < once.outcome.cost_physics
    assert again.spent.physics_steps > once.spent.physics_steps
    assert again.spent.iterations > once.spent.iterations
    at_once = replace(restarted, is_enough=lambda states: True)
    stopped = synthesise(shipped, system, stand_upright(), REST, steps=20, options=at_once)
    assert stopped.spent.physics_steps == once.spent.physics_steps


def test_a_beginning_in_which_the_physics_diverges_is_charged_and_changes_nothing(
    shipped: Emulator, monkeypatch: pytest.MonkeyPatch
):
    system = load_system("pendulum")
    options = DescentOptions(iterations=3)
    search = Search(system, stand_upright(), REST, 20, SearchOptions(options, corrections=0))
    once = make_attempt(search, shipped, options)
    simulate = type(system).simulate_fastest

    def diverging(*arguments):
        runs = simulate(*arguments)
        return runs._replace(has_diverged=np.ones_like(runs.has_diverged))

    monkeypatch.setattr(type(system), "simulate_fastest", diverging)
    again = restart(search, once, 1)
    assert again.outcome is once.outcome
    assert again.spent.physics_steps > once.spent.physics_steps
    assert again.spent.iterations > once.spent.iterations


def test_guesses_around_a_first_one_are_of_every_size_and_the_seeds():
    first = np.linspace(-1, 1, 50)
    guesses = guesses_around(first, 400, seed=3)
    sizes = (guesses - first).std(axis=1)
    assert np.quantile(sizes, 0.1) < 0.1
    assert np.quantile(sizes, 0.9) > 1.0
    assert np.array_equal(guesses, guesses_around(first, 400, seed=3))
    assert not np.array_equal(guesses, guesses_around(first, 400, seed=4))


def test_a_correction_goes_on_from_the_motion_it_corrects(
    shipped: Emulator, monkeypatch: pytest.MonkeyPatch
):
    searches = []
    whole = descend_module.searched_guesses

    def counted(problem, options):
        searches.append(options.searched)
        return whole(problem, options)

    monkeypatch.setattr(descend_module, "searched_guesses", counted)
    options = SearchOptions(DescentOptions(searched=32, starts=2, iterations=2), refinements=0)
    found = synthesise(
        shipped, load_system("pendulum"), stand_upright(), REST, steps=20, options=options
    )
    assert found.spent.corrections > 0
    assert searches == [32]


def test_as_many_equal_guesses_come_to_the_same(shipped: Emulator):
    controls = np.full((2, 20, 3), 0.5)
    found = descend(
        shipped,
        stand_upright(),
        REST,
        steps=20,
        options=DescentOptions(iterations=2, first=controls, starts=2),
    )
    np.testing.assert_array_equal(*found.candidates)


@pytest.mark.parametrize("minutes_wanted", [0.0, 1.2])
def test_an_emulator_that_is_wrong_about_the_motion_is_said_to_be_so(
    minutes_wanted: float, shipped: Emulator
):
    system = load_system("pendulum")
    options = SearchOptions(DescentOptions(iterations=1), refinements=0)
    found = synthesise(shipped, system, stand_upright(), REST, steps=5, options=options)
    right = replace(found, outcome=replace(found.outcome, cost_emulator=357, cost_physics=380))
    assert warnings_of(right, "learn it") == []
    spent = replace(found.spent, minutes_wanted=minutes_wanted)
    outcome = replace(found.outcome, cost_emulator=357, cost_physics=1143)
    wrong = replace(found, outcome=outcome, spent=spent)
    (warning,) = warnings_of(wrong, "learn it")
    assert "J is 1.14e+03 on the physics and 357 on the emulator" in warning
    assert ("--minutes 3" if minutes_wanted else "learn it") in warning
    assert "wrong about this motion" in str(
        dict(outcome_rows(wrong))["trust in the emulator's motion"]
    )


@pytest.mark.parametrize("is_better", [False, True])
@pytest.mark.parametrize("cost", [0.2, 30.0])
@pytest.mark.parametrize("ratio", [1.05, 1.5, 3.0, 60.0])
def test_a_result_says_itself_that_its_emulator_is_wrong(
    is_better: bool, cost: float, ratio: float, shipped: Emulator
):
    options = SearchOptions(DescentOptions(iterations=1))
    found = synthesise(
        shipped, load_system("pendulum"), stand_upright(), REST, steps=5, options=options
    )
    costs = (ratio * cost, cost) if is_better else (cost, ratio * cost)
    found = replace(
        found, outcome=replace(found.outcome, cost_emulator=costs[0], cost_physics=costs[1])
    )
    is_wrong = ratio >= 2 and (ratio - 1) * cost > LARGE_GAP
    assert bool(found.outcome.fault) == is_wrong
    assert ("emulator is wrong about the motion" in repr(found)) == is_wrong
    assert f"J {costs[0]:.3g} on the emulator, {costs[1]:.3g} on the physics" in repr(found)
    assert bool(warnings_of(found, "learn it")) == is_wrong
    trust = str(dict(outcome_rows(found))["trust in the emulator's motion"])
    assert ("wrong about this motion" in trust) == is_wrong
    unproved = replace(found.outcome, is_on_physics=False)
    assert not unproved.fault
