"""Descents in generated C: J, its slope and its quadratic model are those of JAX."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import neuroanimator as na
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.control.descent.c_evaluator import c_evaluator, controls_in_c
from neuroanimator.control.descent.defects import find_defects
from neuroanimator.control.descent.descend import controls_of, pose_problem
from neuroanimator.control.descent.evaluator import Evaluator
from neuroanimator.control.descent.jax_evaluator import JaxEvaluator
from neuroanimator.control.descent.parametrisation import EachStep, Parametrisation, Spline
from neuroanimator.control.descent.problem import Problem
from neuroanimator.control.objective.c_objective import ObjectiveForm
from neuroanimator.control.objective.objective import CostFunction, CostTerm, StateTerm, Trajectory
from neuroanimator.control.objective.objective_cost import objective_cost
from neuroanimator.errors import ArgumentError
from neuroanimator.files.private_folder import kept_folder
from neuroanimator.learn.tasks.all_tasks import TASKS

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
        monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [name])
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
        monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [name])
        controls = controls_of(varied, zs)
        states = np.asarray(emulator.rollout(emulator.rest, controls[0]), float)
        defects = find_defects(emulator, states + 0.01, controls[0])
        cost = objective_cost(objective(), emulator, states, controls[0])
        found[name] = (controls, states, np.asarray(defects), np.array([cost]))
    for mine, wanted in zip(found["c"], found["jax"], strict=True):
        assert_close(mine, wanted)


def quiet(trajectory: Trajectory) -> Float[Array, ""]:
    """A cost of a user's own, of states and controls together."""
    power = trajectory.controls[1:, :1] * trajectory.states[2:, :1]
    return 0.1 * jnp.sum(jnp.cos(trajectory.states) * trajectory.states) + jnp.sum(power)


class Powerful(CostTerm):
    """A term of a user's own, of states and controls together."""

    weight: Float[Array, ""]
    scale: Float[Array, ""]

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        power = trajectory.controls[:, :1] * trajectory.states[1:, -1:]
        return jnp.concatenate([jnp.sin(self.scale * trajectory.states[:, 1]), power.ravel()])


class Gentle(CostTerm):
    """A term of a user's own, of controls alone."""

    weight: Float[Array, ""]
    of_controls = True

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        return jnp.tanh(trajectory.controls / trajectory.control_scale).ravel()


class Seldom(StateTerm):
    """A term of a user's own that looks at the start, one state on the way, and the end."""

    weight: Float[Array, ""]

    def rows(self, steps: int, dt: float) -> list[int]:
        return [0, 2, -1]

    def observe(self, state: Float[Array, "*B S"]) -> Float[Array, "*B S"]:
        return jnp.maximum(state, 0.05)

    def compare(self, observed: Float[Array, "K S"], dt: float) -> Float[Array, " R"]:
        return (observed[1:] - observed[:1]).ravel() / dt


class SeldomOtherwise(Seldom):
    """The same, which compares other states than it says."""

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        return jnp.sin(trajectory.states[3])


ONE = jnp.ones(())
OWN: dict[str, tuple[CostTerm | CostFunction, ...]] = {
    "function": (quiet,),
    "all together": (quiet, Powerful(ONE, ONE), Gentle(2 * ONE), Seldom(ONE), SeldomOtherwise(ONE)),
}


def with_own(emulator: na.Emulator, *costs: CostTerm | CostFunction, steps: int = STEPS) -> Problem:
    return problem(
        emulator, na.Objective.of(na.effort(0.1), *costs), EachStep.of(steps, emulator.bounds)
    )


@pytest.mark.parametrize(
    "kind", [pytest.param("function", marks=pytest.mark.endurance), "all together"]
)
def test_costs_of_ones_own_run_in_c_and_are_those_of_jax(emulator: na.Emulator, kind: str):
    posed = with_own(emulator, *OWN[kind])
    zs = np.random.default_rng(0).normal(size=(19, posed.parametrisation.size))
    found = in_c(posed)
    expected = JaxEvaluator(posed)
    assert_close(found.costs(zs), expected.costs(zs))
    assert_close(found.costs(zs[:2]), expected.costs(zs[:2]))
    for mine, wanted in zip(found.gradients(zs[:2]), expected.gradients(zs[:2]), strict=True):
        assert_close(mine, wanted)
    for mine, wanted in zip(
        found.quadratic_models(zs[:1])[0], expected.quadratic_models(zs[:1])[0], strict=True
    ):
        assert_close(np.array(mine), np.array(wanted))


def form_of(posed: Problem) -> ObjectiveForm:
    return ObjectiveForm.of(posed.objective, posed.emulator, posed.parametrisation.steps)


def test_other_numbers_of_a_term_of_ones_own_need_no_other_program(emulator: na.Emulator):
    one = with_own(emulator, Powerful(ONE, ONE))
    other = with_own(emulator, Powerful(3 * ONE, 0.5 * ONE))
    assert form_of(one) == form_of(other)
    assert form_of(one).about() == form_of(other).about()


def height(times: float, power: int) -> CostFunction:
    numbers = jnp.full(3, times)

    def cost(trajectory: Trajectory) -> Float[Array, ""]:
        return jnp.sum(numbers) * jnp.sum(trajectory.states**power)

    return cost


def term_of(slope: float) -> CostTerm:
    """Return a term of a class that is made anew, of the same name, with a derivative of its own."""

    @jax.custom_jvp
    def same(x: Float[Array, " N"]) -> Float[Array, " N"]:
        return x

    same.defjvp(lambda x, changes: (x[0], slope * changes[0]))

    class Cost(CostTerm):
        weight: Float[Array, ""]

        def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
            return same(trajectory.states[-1])

    return Cost(ONE)


def test_a_program_is_known_by_what_costs_of_ones_own_compute(emulator: na.Emulator):
    def about(cost: CostTerm | CostFunction) -> str:
        return form_of(with_own(emulator, cost, steps=3)).about()

    known = about(height(1.0, 2))
    assert about(height(1.0, 2)) == known
    assert about(height(2.0, 2)) != known
    assert about(height(1.0, 3)) != known
    assert about(term_of(1.0)) == about(term_of(1.0))
    assert about(term_of(1.0)) != about(term_of(2.0))
    assert form_of(with_own(emulator, term_of(1.0))) != form_of(with_own(emulator, term_of(1.0)))


def test_of_whole_motions_only_what_a_cost_computes_with_is_observed(emulator: na.Emulator):
    def cost(trajectory: Trajectory) -> Float[Array, ""]:
        return jnp.sum(trajectory.states[5:, 2] ** 2)

    (view,) = form_of(with_own(emulator, cost)).views
    assert view.rows.tolist() == [5, 6, 7, 8, 9]
    assert view.entries is not None
    assert view.entries.tolist() == [2]
    assert not view.has_controls


def highest(trajectory: Trajectory) -> Float[Array, ""]:
    """A cost with a position that is computed: there is no C for that."""
    return trajectory.states[jnp.argmax(trajectory.states[:, 0]), 0]


def said(capfd: pytest.CaptureFixture[str]) -> list[str]:
    """Return the lines said, without progress: a slow machine takes over a second to generate C."""
    return [line for line in capfd.readouterr().err.splitlines() if " ... " not in line]


def noisy(trajectory: Trajectory) -> Float[Array, ""]:
    noise = jax.random.normal(jax.random.key(0), trajectory.states.shape)
    return jnp.sum(noise * trajectory.states)


@pytest.mark.parametrize("cost", [highest, noisy])
def test_a_cost_there_is_no_c_for_is_left_to_jax_and_that_is_said(
    emulator: na.Emulator, cost: CostFunction, capfd: pytest.CaptureFixture[str]
):
    assert c_evaluator(with_own(emulator, cost)) is None
    (line,) = said(capfd)
    assert f"Objective(Effort, {cost.__name__}): No code can be generated" in line
    assert "JAX is used instead of C" in line


def deepest(trajectory: Trajectory) -> Float[Array, ""]:
    return jnp.sum(jnp.minimum(trajectory.states[:, 0], -0.125) ** 2)


def test_a_cost_of_too_much_c_is_left_to_jax_and_that_is_said(
    emulator: na.Emulator, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    assert form_of(with_own(emulator, deepest)).write().text
    monkeypatch.setattr("neuroanimator.control.objective.c_objective.MAX_TEXT", 10)
    assert c_evaluator(with_own(emulator, deepest)) is None
    (line,) = said(capfd)
    assert "Objective(Effort, deepest): Its C would be" in line
    assert "JAX is used instead of C" in line


class Bent(EachStep):
    """Controls of a user's own."""

    def controls(self, z: Float[Array, " Z"]) -> Float[Array, "T C"]:
        return self.middle + jnp.sin(z.reshape(self.steps, -1)) * self.half


def test_controls_of_ones_own_run_in_c(emulator: na.Emulator):
    bent = Bent.of(STEPS, emulator.bounds)
    zs = np.random.default_rng(0).normal(size=(2, bent.size)).astype(np.float32)
    found = controls_in_c(bent, zs)
    assert found is not None
    assert_close(found, np.stack([bent.controls(jnp.asarray(z)) for z in zs]))


def test_a_term_that_looks_beyond_the_motion_is_refused(emulator: na.Emulator):
    class Late(Seldom):
        def rows(self, steps: int, dt: float) -> list[int]:
            return [12]

    with pytest.raises(ArgumentError, match="Late looks at state 12 of a motion with states 0 to"):
        na.descend(emulator, na.Objective.of(Late(ONE)), emulator.rest, steps=STEPS)


def test_what_is_too_large_for_the_stack_runs_in_c_as_well(
    emulator: na.Emulator, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("neuroanimator.codegen.c_function.MAX_STACK", 10)
    posed = with_own(emulator, height(1.0, 2), steps=3)
    assert "static __thread" in form_of(posed).write().text
    zs = np.random.default_rng(0).normal(size=(2, posed.parametrisation.size))
    assert_close(in_c(posed).costs(zs), JaxEvaluator(posed).costs(zs))
    for mine, wanted in zip(
        in_c(posed).gradients(zs), JaxEvaluator(posed).gradients(zs), strict=True
    ):
        assert_close(mine, wanted)
