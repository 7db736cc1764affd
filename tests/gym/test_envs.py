"""An emulator is a Gymnasium environment, one or a thousand at once."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from swing_up import stand_upright
from waiting import PATIENCE

import neuroanimator.gym
from neuroanimator import Emulator, NeuroAnimatorError, load_emulator
from neuroanimator.gym import EmulatorEnv, EmulatorVectorEnv, RunningCost, mjcf_of
from neuroanimator.gym.state_rows import starts_near_rest

ADVICE = "(A Box observation space m..imum value is|For Box action spaces, we recommend)"
"""check_env's advice for learners, which SI units and a body that may go anywhere cannot follow."""


def random_actions(emulator: Emulator, *shape: int) -> np.ndarray:
    bounds = emulator.bounds
    return (
        np.random.default_rng(0)
        .uniform(bounds.low, bounds.high, (*shape, len(bounds.low)))
        .astype(np.float32)
    )


@pytest.fixture(
    scope="module",
    params=[
        "pendulum-50",
        pytest.param("lander-50", marks=pytest.mark.endurance),
        "fish-50",
        "cube",
    ],
)
def every_kind(request: pytest.FixtureRequest) -> Emulator:
    """Hinges, a free root, a body with muscles and one that is pushed."""
    if request.param == "cube":
        return request.getfixturevalue("untrained_cube")
    return load_emulator(request.param)


@pytest.fixture
def env(shipped: Emulator) -> EmulatorEnv:
    return EmulatorEnv(shipped)


def accepted_by_gymnasium(environment: gymnasium.Env) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", f".*{ADVICE}")
        check_env(environment)


@pytest.mark.parametrize("name", ["pendulum-50", "fish-50"])
def test_gymnasium_accepts_the_environment(name: str):
    accepted_by_gymnasium(gymnasium.make(f"neuroanimator/{name}-v0").unwrapped)


def test_gymnasium_accepts_the_environment_of_a_body_that_is_pushed(
    untrained_cube: Emulator, tmp_path: Path
):
    file = tmp_path / "cube.emulator.safetensors"
    untrained_cube.save(file)
    own = EnvSpec("own/cube-v0", entry_point=EmulatorEnv, kwargs={"emulator": file})
    accepted_by_gymnasium(gymnasium.make(own).unwrapped)


def test_what_does_not_ship_is_no_environment_and_it_is_said_why():
    with pytest.raises(gymnasium.error.NameNotFound, match="cube-50"):
        gymnasium.make("neuroanimator/cube-50-v0")
    with pytest.raises(NeuroAnimatorError, match="no emulator of cube ships"):
        EmulatorEnv("cube-50")


def test_gymnasium_makes_every_shipped_emulator_by_name(shipped: Emulator):
    made = gymnasium.make("neuroanimator/pendulum-50-v0", seconds=1.0)
    start, _ = made.reset(seed=3)
    assert np.array_equal(start, EmulatorEnv(shipped).reset(seed=3)[0])
    several = gymnasium.make_vec("neuroanimator/pendulum-50-v0", num_envs=2)
    assert isinstance(several, EmulatorVectorEnv)
    assert several.reset(seed=3)[0].shape == (2, 6)


def test_the_trajectory_is_the_emulators_rollout(every_kind: Emulator):
    env, actions = EmulatorEnv(every_kind), random_actions(every_kind, 20)
    start, _ = env.reset(seed=1)
    states = np.array([start, *(env.step(action)[0] for action in actions)])
    np.testing.assert_allclose(states, every_kind.rollout(start, actions), atol=1e-3)
    assert np.ptp(states, axis=0).max() > 0.01


def test_rows_that_start_anew_follow_the_rollout_again(every_kind: Emulator):
    many, actions = (
        EmulatorVectorEnv(every_kind, 2, seconds=every_kind.dt),
        random_actions(every_kind, 3, 2),
    )
    many.reset(seed=0)
    _, starts, states = (many.step(action)[0] for action in actions)
    np.testing.assert_allclose(
        states, every_kind.rollout(starts, actions[2][:, None])[:, 1], atol=1e-3
    )


def test_the_same_seed_gives_the_same_episode(env: EmulatorEnv, shipped: Emulator):
    actions, episodes = random_actions(shipped, 5), []
    for _ in range(2):
        start, _ = env.reset(seed=7)
        episodes.append([start, *(env.step(action)[0] for action in actions)])
    assert np.array_equal(*episodes)
    assert not np.array_equal(env.reset(seed=8)[0], start)


def test_each_row_of_many_is_the_single_environment(env: EmulatorEnv, shipped: Emulator):
    many, actions = EmulatorVectorEnv(shipped, 3), random_actions(shipped, 10, 3)
    starts, _ = many.reset(seed=5)
    steps = [many.step(action) for action in actions]
    for row in range(3):
        assert np.array_equal(env.reset(seed=5 + row)[0], starts[row])
        for action, (states, rewards, terminated, truncated, info) in zip(
            actions, steps, strict=True
        ):
            state, reward, is_terminated, is_truncated, single = env.step(action[row])
            np.testing.assert_allclose(states[row], state, atol=1e-3)
            assert rewards[row] == pytest.approx(reward, rel=1e-4)
            assert (terminated[row], truncated[row]) == (is_terminated, is_truncated)
            assert info["covered"][row] == single["covered"]


def test_a_row_that_has_ended_starts_anew_in_the_next_step(shipped: Emulator):
    many, action = EmulatorVectorEnv(shipped, 2, seconds=0.1), np.ones((2, 3))
    many.reset(seed=0)
    ends = [many.step(action)[3].tolist() for _ in range(2)]
    states, rewards, _, truncated, info = many.step(action)
    assert ends == [[False, False], [True, True]]
    assert np.abs(states).max() < 2
    assert rewards.tolist() == [0, 0]
    assert not truncated.any()
    assert info == {}  # as in SyncVectorEnv: nothing was measured
    assert many.step(action)[4]["_covered"].all()


def test_starts_lie_near_rest_and_differ_with_the_noise(shipped: Emulator):
    starts = starts_near_rest(shipped, 0.1, [np.random.default_rng(0)] * 400)
    np.testing.assert_allclose(
        starts.std(axis=0), 0.1 * np.array(shipped.normaliser.unit), rtol=0.2
    )


def test_without_noise_a_start_is_rest_itself(every_kind: Emulator):
    (start,) = starts_near_rest(every_kind, 0.0, [np.random.default_rng(0)])
    assert np.array_equal(start, every_kind.rest)


def test_a_start_lies_as_far_from_rest_as_the_noise_is_large(every_kind: Emulator):
    rest = every_kind.rest
    little, much = (
        starts_near_rest(every_kind, noise, [np.random.default_rng(0)])[0] - rest
        for noise in (1e-6, 1e-5)
    )
    assert np.abs(much).max() > 1e-8
    np.testing.assert_allclose(10 * little, much, atol=1e-3 * np.abs(much).max())


def test_an_episode_starts_where_it_is_told(env: EmulatorEnv, shipped: Emulator):
    start = np.arange(6) / 10
    np.testing.assert_allclose(env.reset(options={"state": start})[0], start, rtol=1e-6)
    states, _ = EmulatorVectorEnv(shipped, 4).reset(options={"state": start})
    np.testing.assert_allclose(states, np.tile(start, (4, 1)), rtol=1e-6)


def test_an_episode_ends_far_outside_what_was_learned(env: EmulatorEnv, shipped: Emulator):
    fastest = float(shipped.domain.high[0])
    for factor, expected in ((0.0, (False, True)), (1.2, (False, False)), (9.0, (True, False))):
        env.reset(options={"state": np.array([0, 0, 0, factor * fastest, 0, 0])})
        _, _, is_terminated, _, info = env.step(np.zeros(3))
        assert (is_terminated, info["covered"]) == expected


def test_an_episode_that_is_lost_in_its_last_step_is_terminated_and_not_truncated(
    shipped: Emulator,
):
    env = EmulatorEnv(shipped, seconds=shipped.dt)
    env.reset(options={"state": np.array([0, 0, 0, 9 * float(shipped.domain.high[0]), 0, 0])})
    assert env.step(np.zeros(3))[2:4] == (True, False)


def test_actions_beyond_the_bounds_are_clipped(env: EmulatorEnv, shipped: Emulator):
    ends = []
    for factor in (1, 10):
        env.reset(seed=0)
        ends.append(env.step(factor * np.array(shipped.bounds.high)))
    assert np.array_equal(ends[0][0], ends[1][0])
    assert ends[0][1] == ends[1][1] == pytest.approx(-1.5 * shipped.dt)


def test_the_return_of_holding_still_does_not_depend_on_the_super_step():
    returns = []
    for name, steps in (("pendulum-25", 40), ("pendulum-100", 10)):
        env = EmulatorEnv(name, objective=stand_upright(), noise=0.0)
        env.reset()
        returns.append(sum(env.step(np.zeros(3))[1] for _ in range(steps)))
    assert returns[0] == pytest.approx(returns[1], rel=0.01)
    assert returns[0] < -100


def test_the_goal_costs_nothing_but_the_effort(shipped: Emulator):
    reward = RunningCost.of(shipped, stand_upright())
    up = jnp.array([jnp.pi, 0, 0, 0, 0, 0])
    assert reward(up, jnp.zeros(3), up) == pytest.approx(0, abs=1e-6)
    assert reward(up, jnp.array([30.0, 0, 0]), up) == pytest.approx(-shipped.dt / 2)


def test_a_reward_of_ones_own_sees_the_step(shipped: Emulator):
    def speed_gained(state, control, following):
        return following[3] - state[3] + control[1]

    env = EmulatorEnv(shipped, reward=speed_gained)
    start, _ = env.reset(seed=0)
    state, reward, *_ = env.step(np.array([20.0, 3.0, 0.0]))
    assert reward == pytest.approx(state[3] - start[3] + 3, rel=1e-5)


def test_what_was_returned_is_not_changed_later(env: EmulatorEnv):
    start, _ = env.reset(seed=0)
    kept = start.copy()
    env.step(np.array([30.0, 0, 0]))
    assert np.array_equal(start, kept)


@pytest.mark.parametrize(("env_id", "joints"), [("Swimmer-v5", 5), ("InvertedPendulum-v5", 2)])
def test_the_models_of_gymnasium_are_found(env_id: str, joints: int):
    assert mujoco.MjModel.from_xml_path(str(mjcf_of(env_id))).nq == joints


def test_an_unknown_environment_is_answered_with_the_valid_ones():
    with pytest.raises(
        NeuroAnimatorError, match="No MuJoCo environment called 'Swimer-v5'.*Hopper-v5.*Swimmer-v5"
    ):
        mjcf_of("Swimer-v5")
    with pytest.raises(NeuroAnimatorError, match="CartPole-v1"):
        mjcf_of("CartPole-v1")


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"emulator": "pendulun"}, "No emulator file 'pendulun'.*pendulum-50"),
        ({"seconds": 0.0}, "seconds: wanted at least one super step of 0.05 s, got 0"),
        ({"seconds": float("nan")}, "seconds: wanted"),
        ({"num_envs": 0}, "num_envs: wanted one or more"),
        ({"objective": stand_upright(), "reward": max}, "objective and reward: got both"),
    ],
)
def test_an_environment_that_makes_no_sense_is_refused(choices: dict, message: str):
    with pytest.raises(NeuroAnimatorError, match=message):
        EmulatorVectorEnv(**{"emulator": "pendulum-50", **choices})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"position": [0]}, "No reset option called 'position'. Options: state."),
        ({"state": np.zeros(5)}, "state: wanted 6 numbers"),
        ({"state": np.full(6, np.nan)}, "not finite"),
        ({"state": np.zeros((3, 6))}, r"state: wanted shape \(6,\) or \(1, 6\), got \(3, 6\)"),
    ],
)
def test_a_start_that_makes_no_sense_is_refused(env: EmulatorEnv, options: dict, message: str):
    with pytest.raises(NeuroAnimatorError, match=message):
        env.reset(options=options)


@pytest.mark.parametrize(
    ("action", "message"), [(np.zeros(2), "wanted 3 numbers"), (np.full(3, np.inf), "not finite")]
)
def test_an_action_that_makes_no_sense_is_refused(
    env: EmulatorEnv, action: np.ndarray, message: str
):
    env.reset(seed=0)
    with pytest.raises(NeuroAnimatorError, match=message):
        env.step(action)


def test_without_gymnasium_one_line_says_how_to_install_it():
    code = "import sys; sys.modules['gymnasium'] = None; import neuroanimator.gym"
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE
    )
    last = run.stderr.strip().splitlines()[-1]
    assert last.endswith("Gymnasium is missing. Install it with: pip install 'neuroanimator[gym]'")


def test_registering_twice_changes_nothing():
    before = gymnasium.registry["neuroanimator/pendulum-50-v0"]
    neuroanimator.gym.register()
    assert gymnasium.registry["neuroanimator/pendulum-50-v0"] is before
