"""A planner drives somebody else's environment as it drives the physics, and learns from what it saw there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from swing_up import PENDULUM, is_upright, stand_upright

from neuroanimator import Emulator, NeuroAnimatorError, Objective
from neuroanimator.control import (
    DmEnvironment,
    Episode,
    PhysicsPlant,
    Planner,
    control_environment,
    control_plant,
    learn_from,
    moved_on,
    mujoco_state,
)
from neuroanimator.control.objective.costs import effort
from neuroanimator.control.objective.goals import goal
from neuroanimator.learn.data.config import MAX_UNROLL
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.planning.learn import SEEN_SHARE, with_episodes

HOLD = 5
"""Steps of the environment in a super step."""
STEPS = 20
SUPER_STEPS = 60


class PendulumWorld:
    """The pendulum in MuJoCo with Gymnasium's signatures: a step is 10 ms, and a link may be heavier than was learnt."""

    def __init__(self, mass: float = 1.0, last: int = 10_000):
        self.model = PENDULUM.model_with(PENDULUM.truth)
        self.model.body_mass[-1] *= mass
        self.model.body_inertia[-1] *= mass
        self.data = mujoco.MjData(self.model)
        self.last = last
        self.action_space = SimpleNamespace(shape=(3,))
        self.dt = PENDULUM.physics_dt * 50 / HOLD

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qvel[:] = 0.0 if seed is None else np.random.default_rng(seed).normal(size=3)
        return np.array(self.data.qpos), {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.data.ctrl[:] = action
        count = round(PENDULUM.physics_dt * 50 / HOLD / self.model.opt.timestep)
        for _ in range(count):
            mujoco.mj_step(self.model, self.data)
        self.last -= 1
        return np.array(self.data.qpos), -1.0, False, self.last <= 0, {}


@pytest.fixture(scope="module")
def planner(shipped: Emulator) -> Planner:
    objective = Objective.of(effort(), goal(PENDULUM, "upright", since=0, weight=20.0))
    return Planner.of(shipped, objective, STEPS)


def test_an_environment_of_the_same_physics_does_what_the_physics_does(planner: Planner):
    world = PendulumWorld()
    found = control_environment(planner, world, SUPER_STEPS)
    plant = PhysicsPlant(PENDULUM, planner.emulator.dt)
    driven = control_plant(planner, plant, PENDULUM.rest, SUPER_STEPS)
    assert is_upright(found.states[-1])
    np.testing.assert_allclose(found.states[:10], driven.states[:10], atol=1e-6)
    assert found.total_reward == -SUPER_STEPS * HOLD == -found.environment_steps
    assert not found.is_terminated


def test_an_episode_ends_where_the_environment_ends_it(planner: Planner):
    found = control_environment(planner, PendulumWorld(last=12), SUPER_STEPS)
    assert found.environment_steps == 12
    assert len(found.controls) == 3 == len(found.states) - 1


def test_a_super_step_that_the_environment_cuts_short_is_not_learnt_from(
    planner: Planner, transitions: Transitions
):
    whole = MAX_UNROLL + 2
    cut = control_environment(planner, PendulumWorld(last=whole * HOLD + 2), SUPER_STEPS)
    assert cut.whole_steps == whole == len(cut.controls) - 1
    taught = with_episodes(transitions, [cut])
    last = cut.states[-1].astype(np.float32)
    assert not (taught.states == last).all(axis=-1).any()
    before_last = cut.states[-2].astype(np.float32)
    assert (taught.states == before_last).all(axis=-1).any()


def test_every_episode_may_have_numbers_of_its_own(planner: Planner):
    lazy = Objective.of(effort(1e6), goal(PENDULUM, "upright", since=0, weight=20.0))
    idle = control_environment(
        planner, PendulumWorld(), 5, objective_of=lambda world, seen: lazy, seed=3
    )
    again = control_environment(planner, PendulumWorld(), 5, seed=3)
    assert np.abs(idle.controls).max() < 0.1 * np.abs(again.controls).max()
    np.testing.assert_array_equal(idle.states[0], again.states[0])


def test_dm_controls_time_steps_are_gymnasiums(planner: Planner):
    world = PendulumWorld()
    moments = iter([(False, 1.0), (False, 1.0), (True, 0.0)])

    def step(action: np.ndarray) -> Any:
        observation, reward, *_ = world.step(action)
        is_last, discount = next(moments)
        return SimpleNamespace(
            observation=observation, reward=reward, discount=discount, last=lambda: is_last
        )

    dm = SimpleNamespace(
        reset=lambda: SimpleNamespace(observation=world.reset()[0]),
        step=step,
        physics=SimpleNamespace(data=world.data),
        control_timestep=lambda: planner.emulator.dt,
    )
    found = control_environment(planner, DmEnvironment(dm), SUPER_STEPS)
    assert found.is_terminated
    assert len(found.controls) == 3
    np.testing.assert_array_equal(found.states[-1], mujoco_state(world, None))


def test_what_was_seen_is_a_fair_share_of_what_is_learnt_from(
    planner: Planner, transitions: Transitions
):
    world = PendulumWorld()
    episodes = [control_environment(planner, world, steps, seed=steps) for steps in (3, 10, 20)]
    data = with_episodes(transitions, episodes)
    known = len(transitions.states)
    np.testing.assert_array_equal(data.states[:known], transitions.states)
    share = 1 - known / len(data.states)
    assert share == pytest.approx(SEEN_SHARE, abs=0.01)
    last = episodes[-1]
    np.testing.assert_allclose(data.states[-1], last.states[-MAX_UNROLL - 1 :], rtol=1e-6)
    np.testing.assert_allclose(data.controls[-1], last.controls[-MAX_UNROLL:], rtol=1e-6)
    assert len(np.unique(data.run)) == len(np.unique(transitions.run)) + 2


@pytest.mark.endurance
def test_what_was_seen_is_learnt(planner: Planner, transitions: Transitions):
    heavy = control_environment(planner, PendulumWorld(mass=1.5), SUPER_STEPS)
    taught = learn_from(planner.emulator, [heavy], transitions, updates=500)

    def error(emulator: Emulator) -> float:
        said = emulator.rollout(heavy.states[:-1], heavy.controls[:, None])[:, 1]
        return float(np.sqrt(np.mean((said - heavy.states[1:]) ** 2)))

    assert error(taught) < 0.7 * error(planner.emulator)


def test_guesses_lead_away_from_controls_at_their_bounds(shipped: Emulator):
    objective = stand_upright(times=tuple(0.05 * np.arange(1, STEPS + 1)))
    alone = Planner.of(shipped, objective, STEPS)
    guessing = Planner.of(shipped, objective, STEPS, guesses=64)
    pushed = np.tile(shipped.bounds.high, (STEPS, 1))
    stuck = alone.plan(PENDULUM.rest, pushed)
    found = guessing.plan(PENDULUM.rest, pushed)
    assert found.cost < stuck.cost
    np.testing.assert_array_equal(guessing.plan(PENDULUM.rest, pushed).controls, found.controls)
    assert guessing.plan(PENDULUM.rest).cost <= 1.001 * alone.plan(PENDULUM.rest).cost


def test_more_starts_find_no_worse_plans(shipped: Emulator):
    objective = stand_upright(times=tuple(0.05 * np.arange(1, STEPS + 1)))
    few = Planner.of(shipped, objective, STEPS, guesses=64).plan(PENDULUM.rest)
    many = Planner.of(shipped, objective, STEPS, guesses=64, starts=8).plan(PENDULUM.rest)
    assert many.cost <= few.cost * (1 + 1e-6)


def test_a_plan_is_followed_until_it_is_planned_again(planner: Planner):
    often = control_environment(planner, PendulumWorld(), 7)
    found = control_environment(planner, PendulumWorld(), 7, every=3)
    assert (len(often.plan_seconds), len(found.plan_seconds)) == (7, 3)
    plan = planner.plan(PENDULUM.rest)
    np.testing.assert_allclose(found.controls[:3], plan.controls[:3], rtol=1e-6)
    again = planner.plan(found.states[3], moved_on(plan.controls, 3))
    np.testing.assert_allclose(found.controls[3:6], again.controls[:3], rtol=1e-6)
    short = control_environment(planner, PendulumWorld(last=12), SUPER_STEPS, every=20)
    assert len(short.controls) == 3
    assert short.environment_steps == 12


class Broken(PendulumWorld):
    """A world of which one answer is replaced."""

    def __init__(self, **answers: Any):
        super().__init__()
        for name, answer in answers.items():
            setattr(self, name, answer)


REFUSED: dict[str, tuple[Any, dict[str, Any]]] = {
    "environment.step: wanted (observation, reward, terminated, truncated, info) as Gymnasium has it, got 4 things": (
        Broken(step=lambda action: (0, 0.0, False, {})), {},
    ),
    "environment.reset: wanted (observation, info) as Gymnasium has it, got an array of shape (3,)": (
        Broken(reset=lambda seed: np.zeros(3)), {},
    ),
    "wanted a finite number as reward, got nan": (
        Broken(step=lambda action: (0, float("nan"), False, False, {})), {},
    ),
    "wanted a finite number as reward, got an array of shape (2,)": (
        Broken(step=lambda action: (0, np.zeros(2), False, False, {})), {},
    ),
    "environment: its actions have shape (7,), the emulator 3 controls": (
        Broken(action_space=SimpleNamespace(shape=(7,))), {},
    ),
    "environment: its actions are a SimpleNamespace, the emulator 3 controls": (
        Broken(action_space=SimpleNamespace(spaces={})), {},
    ),
    "environment: its action 1 goes from -0.1 to 0.1, the emulator's": (
        Broken(action_space=SimpleNamespace(shape=(3,), low=[-99, -0.1, -99], high=[99, 0.1, 99])), {},
    ),
    "environment.reset: its observation_space has shape (4,), the observation (3,)": (
        Broken(observation_space=SimpleNamespace(shape=(4,))), {},
    ),
    "environment.step: its observation_space has shape (3,), the observation (2,)": (
        Broken(
            observation_space=SimpleNamespace(shape=(3,)),
            step=lambda action: (np.zeros(2), 0.0, False, False, {}),
        ), {},
    ),
    "wanted True or False as terminated and truncated, got an array of shape (2,)": (
        Broken(step=lambda action: (0, 0.0, np.zeros(2), False, {})), {},
    ),
    "state_of: no MuJoCo data in NoneType. Wanted a function (environment, observation)": (
        Broken(unwrapped=None), {},
    ),
    "state_of: wanted": (PendulumWorld(), {"state_of": lambda world, seen: np.zeros(4)}),
    "the emulator's super step of 0.05 s is not a whole multiple of its step of 0.03 s": (
        Broken(dt=0.03), {},
    ),
    "steps and hold: wanted at least 1, got 60 and 0": (PendulumWorld(), {"hold": 0}),
    "every: wanted 1 to the 20 super steps of a plan, got 21": (PendulumWorld(), {"every": 21}),
}  # fmt: skip


@pytest.mark.parametrize("message", sorted(REFUSED))
def test_a_strange_environment_is_refused_in_one_line(message: str, planner: Planner):
    world, options = REFUSED[message]
    with pytest.raises(NeuroAnimatorError) as caught:
        control_environment(planner, world, SUPER_STEPS, **options)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_episode_shorter_than_a_window_teaches_nothing(
    planner: Planner, transitions: Transitions
):
    steps = MAX_UNROLL - 1
    nothing = np.zeros(steps)
    states = np.zeros((MAX_UNROLL, 6))
    short = Episode(np.zeros((steps, 3)), states, nothing, nothing, False, steps, steps)
    with pytest.raises(NeuroAnimatorError, match=f"at least {MAX_UNROLL} super steps"):
        learn_from(planner.emulator, [short], transitions)
