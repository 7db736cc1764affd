"""The tasks as environments: what control wants is what is rewarded, seen from the body."""

from __future__ import annotations

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from neuroanimator import DescentOptions, NeuroAnimatorError, descend
from neuroanimator.control.objective.objective_cost import objective_cost
from neuroanimator.control.policies.pilot import Pilot
from neuroanimator.film.graphics import graphics_backend
from neuroanimator.gym import TASK_NAMES, EmulatorEnv
from neuroanimator.gym.batched_step import MAX_OBSERVATION
from neuroanimator.gym.task_envs import TaskEnv, TaskVectorEnv
from neuroanimator.gym.task_rows import TRIALS, TaskRows
from neuroanimator.gym.vector_env import RowsVectorEnv
from neuroanimator.learn.tasks.all_tasks import TASKS

KINDS = [
    "pendulum-swing-up",
    pytest.param("truck-park", marks=pytest.mark.endurance),
    pytest.param("lander-land", marks=pytest.mark.endurance),
    "fish-reach",
]
"""Hinges, wheels among obstacles, a root that flies, a body with muscles."""


@pytest.fixture(scope="module", params=KINDS)
def many(request: pytest.FixtureRequest) -> TaskVectorEnv:
    return TaskVectorEnv(request.param, 3)


def rows_of(env: RowsVectorEnv) -> TaskRows:
    """Return the trials of an environment."""
    assert isinstance(env.rows, TaskRows)
    return env.rows


def actions_of(env: TaskVectorEnv, count: int, share: float = 1.0) -> np.ndarray:
    """Return random actions (count, B, C), up to that `share` of the range."""
    space = env.single_action_space
    middle, half = (space.high + space.low) / 2, (space.high - space.low) / 2
    shape = (count, env.num_envs, *space.high.shape)
    return (middle + share * half * np.random.default_rng(0).uniform(-1, 1, shape)).astype(
        np.float32
    )


@pytest.mark.parametrize(
    "name", ["pendulum-swing-up", pytest.param("fish-reach", marks=pytest.mark.endurance)]
)
def test_gymnasium_accepts_the_task(name: str):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*For Box action spaces, we recommend")
        check_env(gymnasium.make(f"neuroanimator/{name}-v0").unwrapped)


def test_every_task_is_an_environment():
    assert set(TASK_NAMES) == set(TASKS)
    assert all(f"neuroanimator/{name}-v0" in gymnasium.registry for name in TASKS)


def test_rewards_sum_to_what_was_taken_off_the_tasks_own_objective(many: TaskVectorEnv):
    many.reset(options={"trial": 3})
    trial, emulator = rows_of(many).trial(3), many.emulator
    taken = actions_of(many, many.rows.steps, share=0.3)
    taken[:] = taken[:, :1]
    total, count, terminated = 0.0, 0, np.zeros(3, bool)
    for action in taken:
        _, rewards, terminated, truncated, _ = many.step(action)
        total, count = total + rewards[0], count + 1
        if terminated[0] or truncated[0]:
            break
    total -= 1.0 * (
        terminated[0]
        and trial.is_success(np.asarray(rows_of(many).episodes.states[0, : count + 1], float))
    )
    total += 1.0 * (
        terminated[0]
        and not trial.is_success(np.asarray(rows_of(many).episodes.states[0, : count + 1], float))
    )
    held = np.zeros((many.rows.steps, taken.shape[-1]))
    still = np.repeat(trial.start[None], many.rows.steps + 1, axis=0)
    first = objective_cost(trial.objective, emulator, still, held)
    held[:count] = taken[:count, 0]
    motion = np.asarray(emulator.rollout(trial.start, held[:count]))
    states = np.concatenate([motion, np.repeat(motion[-1:], many.rows.steps - count, axis=0)])
    last = objective_cost(trial.objective, emulator, states, held)
    assert total == pytest.approx(1 - last / first, rel=0.02, abs=0.02)


def test_each_row_is_the_single_environment(many: TaskVectorEnv):
    taken = actions_of(many, 4)
    observations, info = many.reset(seed=5)
    steps = [many.step(action) for action in taken]
    alone = TaskEnv(rows_of(many).solver.task.name)
    for row in (0, 2):
        first, told = alone.reset(seed=5 + row)
        np.testing.assert_allclose(first, observations[row], atol=1e-4)
        assert told["trial"] == info["trial"][row]
        for action, (states, rewards, terminated, truncated, _) in zip(taken, steps, strict=True):
            state, reward, is_terminated, is_truncated, _ = alone.step(action[row])
            np.testing.assert_allclose(states[row], state, atol=2e-3)
            assert rewards[row] == pytest.approx(reward, abs=2e-3)
            assert (terminated[row], truncated[row]) == (is_terminated, is_truncated)


def test_observations_are_bounded_and_of_order_one(many: TaskVectorEnv):
    observation, _ = many.reset(seed=0)
    for action in actions_of(many, 10):
        observation = many.step(action)[0]
        assert many.observation_space.contains(observation)
    assert 0.3 < np.abs(observation).max() < MAX_OBSERVATION


def test_time_is_up_when_the_task_says_and_a_row_starts_anew():
    many = TaskVectorEnv("pendulum-swing-up", 2)
    many.reset(seed=0)
    still = np.zeros((2, 3), np.float32)
    for number in range(many.rows.steps):
        _, _, terminated, truncated, _ = many.step(still)
        assert not terminated.any()
        assert truncated.all() == (number == many.rows.steps - 1)
    observation, rewards, terminated, truncated, info = many.step(still)
    assert rewards.tolist() == [0, 0]
    assert not truncated.any()
    assert "success" not in info  # as in SyncVectorEnv: nothing was measured
    assert info["_trial"].all()
    np.testing.assert_allclose(observation[:, -1], 1.0)
    assert many.step(still)[4]["_success"].all()


def test_the_target_is_seen_from_the_body():
    env = TaskEnv("fish-reach")
    inside = rows_of(env.vector_env)
    for number in range(5):
        observation, _ = env.reset(options={"trial": number})
        trial, scale = inside.trial(number), inside.scale
        pose = Pilot("fish").policy.pose(np.asarray(inside.emulator.encode(trial.start)))
        way = np.array(trial.aim.position) - pose.position
        position, direction, up = observation[-10:-7], observation[-7:-4], observation[-4:-1]
        assert np.linalg.norm(position) == pytest.approx(np.linalg.norm(way) / scale, rel=1e-3)
        assert position[0] == pytest.approx(way @ pose.forward / scale, abs=1e-3)
        assert direction.tolist() == [0, 0, 0]
        assert up[2] > 0.8
        assert observation[-1] == 1.0


def test_a_crash_ends_the_episode_as_a_failure():
    env = TaskEnv("lander-land")
    env.reset(options={"trial": 0})
    is_terminated, total, info = False, [], {}
    while not is_terminated:
        _, reward, is_terminated, is_truncated, info = env.step(env.action_space.low)
        total.append(reward)
        assert not is_truncated
    assert not info["success"]
    assert total[-1] < -0.5


def test_what_a_descent_finds_earns_nearly_all_there_is_to_earn():
    env = TaskEnv("pendulum-swing-up")
    inside = rows_of(env.vector_env)
    trial = inside.trial(1)
    found = descend(
        inside.emulator,
        trial.objective,
        trial.start,
        steps=inside.steps,
        options=DescentOptions(starts=16),
    )
    env.reset(options={"trial": 1})
    total = 0.0
    for control in found.controls:
        _, reward, is_terminated, is_truncated, _ = env.step(control.astype(np.float32))
        total += reward
        if is_terminated or is_truncated:
            break
    assert total > 0.9


@pytest.mark.skipif(graphics_backend() is None, reason="no OpenGL to draw with")
@pytest.mark.parametrize(
    "make",
    [
        lambda: TaskEnv("fish-reach", "rgb_array"),
        lambda: EmulatorEnv("pendulum", render_mode="rgb_array"),
    ],
)
def test_pictures_show_what_moves(make):
    env = make()
    env.reset(seed=0)
    before = env.render()
    for _ in range(8):
        env.step(env.action_space.high)
    after = env.render()
    assert before.shape == after.shape == (360, 480, 3)
    assert before.dtype == np.uint8
    assert before.std() > 5
    assert np.abs(after.astype(int) - before).max() > 50
    env.close()
    env.close()


NEVER_CLOSED = """
from neuroanimator.gym import EmulatorEnv
env = EmulatorEnv("pendulum", render_mode="rgb_array")
env.reset(seed=0)
print(env.render().shape)
"""


@pytest.mark.skipif(graphics_backend() is None, reason="no OpenGL to draw with")
def test_an_environment_that_nobody_closes_ends_in_silence():
    command = [sys.executable, "-c", NEVER_CLOSED]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.stdout == "(360, 480, 3)\n"
    assert done.stderr == ""


def test_without_a_render_mode_there_is_no_picture():
    env = TaskEnv("pendulum-swing-up")
    env.reset(seed=0)
    assert env.render() is None


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TaskEnv("fish-fly"), "No task called 'fish-fly'. Tasks: pendulum-swing-up"),
        (lambda: TaskVectorEnv("fish-reach", 0), "num_envs: wanted one or more"),
        (lambda: TaskEnv("fish-reach", "human"), "No render mode called 'human'. Modes: rgb_array"),
        (lambda: EmulatorEnv("pendulum", render_mode="human"), "No render mode called 'human'"),
        (
            lambda: TaskEnv("pendulum-swing-up").reset(options={"state": 0}),
            "No reset option called 'state'",
        ),
        (
            lambda: TaskEnv("pendulum-swing-up").reset(options={"trial": TRIALS}),
            "trial: wanted numbers from 0 to 99",
        ),
        (
            lambda: TaskEnv("pendulum-swing-up").reset(options={"trial": "one"}),
            "trial: wanted numbers",
        ),
        (
            lambda: TaskVectorEnv("pendulum-swing-up", 3).reset(options={"trial": [1, 2]}),
            r"trial: wanted shape \(\) or \(3,\), got \(2,\)",
        ),
        (lambda: TaskEnv("pendulum-swing-up").step([np.nan] * 3), "not finite"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(make, message: str):
    with pytest.raises(NeuroAnimatorError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
