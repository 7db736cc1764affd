"""Descents in generated C: J, its slope and its quadratic model are those of JAX."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import neuroanimator as na
from neuroanimator.compiler.compiler import find_compiler
from neuroanimator.control.descent.c_evaluator import c_evaluator
from neuroanimator.control.descent.defects import find_defects
from neuroanimator.control.descent.descend import pose_problem
from neuroanimator.control.descent.evaluator import Evaluator
from neuroanimator.control.descent.evaluators import controls_of
from neuroanimator.control.descent.jax_evaluator import JaxEvaluator
from neuroanimator.control.descent.parametrisation import EachStep, Parametrisation, Spline
from neuroanimator.control.descent.problem import Problem
from neuroanimator.control.objective.objective import CostTerm, objective_cost
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.storage.private_folder import kept_folder
from neuroanimator.tasks.all_tasks import TASKS

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

STEPS = 9
CLOSE = 1e-4


@pytest.fixture(scope="module")
def emulator() -> na.Emulator:
    return na.load_emulator("pendulum-50")


def objective(weight: float = 0.1) -> na.Objective:
    system = na.load_system("pendulum")
    return na.Objective.of(
        na.effort(weight),
        na.smoothness(0.1),
        na.goal(system, "upright"),
        na.stay_within(system, "angle", -1.0, 1.0, within=0.1),
    )


def problem(
    emulator: na.Emulator, asked: na.Objective, parametrisation: Parametrisation | None = None
) -> Problem:
    """Return `asked` of a motion that begins beside rest, with random defects."""
    if parametrisation is None:
        parametrisation = EachStep.of(STEPS, emulator.bounds)
    start = emulator.rest + 0.1
    shape = (parametrisation.steps, emulator.state.size)
    defects = 0.05 * np.random.default_rng(1).normal(size=shape)
    return pose_problem(emulator, asked, parametrisation, start, jnp.asarray(defects, jnp.float32))


def in_c(posed: Problem) -> Evaluator:
    evaluator = c_evaluator(posed)
    assert evaluator is not None
    return evaluator


def assert_close(found: np.ndarray, expected: np.ndarray) -> None:
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=CLOSE, atol=CLOSE * size)


@pytest.mark.parametrize("kind", ["each step", "spline"])
def test_cost_slope_and_quadratic_model_are_those_of_jax(emulator: na.Emulator, kind: str):
    varied = EachStep.of(STEPS, emulator.bounds)
    if kind == "spline":
        varied = Spline.of(STEPS, 5, emulator.bounds)
    posed = problem(emulator, objective(), varied)
    expected = JaxEvaluator(posed)
    found = in_c(posed)
    zs = np.random.default_rng(0).normal(size=(19, varied.size))
    assert_close(found.costs(zs), expected.costs(zs))
    for mine, wanted in zip(found.gradients(zs[:3]), expected.gradients(zs[:3]), strict=True):
        assert_close(mine, wanted)
    for mine, wanted in zip(
        found.quadratic_models(zs[:3]), expected.quadratic_models(zs[:3]), strict=True
    ):
        assert mine.cost == pytest.approx(wanted.cost, rel=CLOSE)
        assert_close(mine.slope, wanted.slope)
        assert_close(mine.curvature, wanted.curvature)
    assert_close(found.motion(zs[0]).states, expected.motion(zs[0]).states)


@pytest.mark.parametrize(
    "name",
    [
        "fish-turn",
        pytest.param("dolphin-swim", marks=pytest.mark.endurance),
        pytest.param("truck-park", marks=pytest.mark.endurance),
    ],
)
def test_what_terms_observe_of_bodies_and_obstacles_is_what_jax_sees(name: str):
    """Swimmers are observed from their few latent numbers, but for the start; obstacles in every state."""
    task = TASKS[name]
    system = na.load_system(task.system)
    emulator = na.load_emulator(f"{task.system}-{task.substeps}")
    trial = task.draw(system, np.random.default_rng(0), STEPS, emulator.dt)
    varied = Spline.of(STEPS, 5, emulator.bounds)
    posed = pose_problem(emulator, trial.objective, varied, trial.start)
    z = 0.1 * np.random.default_rng(0).normal(size=(1, varied.size))
    found = in_c(posed)
    expected = JaxEvaluator(posed)
    assert_close(found.motion(z[0]).states, expected.motion(z[0]).states)
    (mine,) = found.quadratic_models(z)
    (wanted,) = expected.quadratic_models(z)
    assert_close(found.costs(z), np.array([wanted.cost]))
    assert_close(mine.slope, wanted.slope)
    assert_close(mine.curvature, wanted.curvature)
    assert_close(found.gradients(z)[1][0], mine.slope)


def test_another_start_and_other_numbers_need_no_other_program(emulator: na.Emulator):
    posed = problem(emulator, objective())
    first = in_c(posed)
    folder = kept_folder("c-programs")
    assert folder is not None
    before = set(folder.iterdir())
    dearer = problem(emulator, objective(5.0))
    z = np.random.default_rng(0).normal(size=(2, posed.parametrisation.size))
    assert_close(in_c(dearer).costs(z), JaxEvaluator(dearer).costs(z))
    elsewhere = emulator.rest - 0.3
    assert_close(first.at(elsewhere).costs(z), JaxEvaluator(posed).at(elsewhere).costs(z))
    assert set(folder.iterdir()) == before


def test_one_objective_is_judged_by_the_scale_of_each_problems_controls(emulator: na.Emulator):
    """Full effort is another for every emulator: what was made for one is not what another needs."""
    posed = problem(emulator, objective())
    z = np.random.default_rng(0).normal(size=(1, posed.parametrisation.size))
    before = in_c(posed).costs(z)
    weaker = dataclasses.replace(posed, control_scale=posed.control_scale / 3)
    found = in_c(weaker).costs(z)
    assert found > before
    assert_close(found, JaxEvaluator(weaker).costs(z))


def test_a_controller_is_found_as_with_jax(emulator: na.Emulator, monkeypatch: pytest.MonkeyPatch):
    found = {}
    for name in ("jax", "c"):
        monkeypatch.setattr("neuroanimator.backend._chosen", [name])
        found[name] = na.descend(emulator, objective(), emulator.rest, steps=STEPS)
    assert found["c"].cost == pytest.approx(found["jax"].cost, rel=0.01)
    assert found["c"].iterations == found["jax"].iterations


def test_defects_controls_and_costs_are_those_of_jax(
    emulator: na.Emulator, monkeypatch: pytest.MonkeyPatch
):
    varied = EachStep.of(STEPS, emulator.bounds)
    zs = np.random.default_rng(0).normal(size=(2, varied.size))
    found = {}
    for name in ("jax", "c"):
        monkeypatch.setattr("neuroanimator.backend._chosen", [name])
        controls = controls_of(varied, zs)
        states = np.asarray(emulator.rollout(emulator.rest, controls[0]), float)
        defects = find_defects(emulator, states + 0.01, controls[0])
        cost = objective_cost(objective(), emulator, states, controls[0])
        found[name] = (controls, states, np.asarray(defects), np.array([cost]))
    for mine, wanted in zip(found["c"], found["jax"], strict=True):
        assert_close(mine, wanted)


def quiet(trajectory: Trajectory) -> Float[Array, ""]:
    """A cost of a user's own."""
    return jnp.sum(trajectory.states**2)


class Quiet(CostTerm):
    """A term of a user's own: its code is not part of what a kept program is known by."""

    weight: Float[Array, ""]

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        return trajectory.states.ravel()


@pytest.mark.parametrize("cost", [quiet, Quiet(jnp.ones(()))], ids=["function", "term"])
def test_costs_of_a_users_own_are_left_to_jax(emulator: na.Emulator, cost: object):
    asked = na.Objective.of(na.effort(0.1), cost)  # pyright: ignore[reportArgumentType]
    assert c_evaluator(problem(emulator, asked)) is None


def test_a_map_too_large_for_the_stack_is_left_to_jax(
    emulator: na.Emulator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("neuroanimator.codegen.c_map.MOST_SCRATCH", 10)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert c_evaluator(problem(emulator, objective())) is None
