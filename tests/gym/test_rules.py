"""Rules of episodes: a task in functions is the environment's own, in an emulator and on the physics."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium_rules import RULES

from neuroanimator import DatasetConfig, Emulator, NeuroAnimatorError, TrainingConfig
from neuroanimator.gym import EmulatorVectorEnv, EpisodeRules, PhysicsVectorEnv, mjcf_of
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.planning.environments import mujoco_state
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.physics.loading import resolve

STEPS = 60

DEFINITIONS = {
    "Swimmer-v5": (
        0.01,
        {
            "slider1": "cyclic",
            "slider2": "cyclic",
            "free_body_rot": "sine",
            "motor1_rot": "plain",
            "motor2_rot": "plain",
        },
    ),
    "Hopper-v5": (
        0.002,
        {
            "rootx": "cyclic",
            "rootz": "plain",
            "rooty": "sine",
            "thigh_joint": "plain",
            "leg_joint": "plain",
            "foot_joint": "plain",
        },
    ),
}
"""Physics step [s] and kinds of joints; `neuroanimator new` writes more, and takes longer."""


@pytest.fixture(scope="module", params=list(DEFINITIONS))
def task(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """(id, untrained emulator) of an environment of Gymnasium's; a super step is a step of it."""
    step, joints = DEFINITIONS[request.param]
    name = request.param.split("-")[0].lower()
    folder = tmp_path_factory.mktemp(name)
    lines = [f'name = "{name}"', 'kind = "mujoco"', f'model = "{name}.xml"', "[physics]"]
    lines += [f"step = {step}", f"truth_step = {step}", f"fine_step = {step / 10}"]
    lines += [f'{scheme}integrator = "rk4"' for scheme in ("", "truth_", "fine_")]
    lines += ["[state]", *[f'{joint} = "{kind}"' for joint, kind in joints.items()]]
    (folder / f"{name}.xml").write_bytes(mjcf_of(request.param).read_bytes())
    toml = folder / f"{name}.toml"
    toml.write_text("\n".join(lines))
    system, definition, _ = resolve(str(toml))
    config = DatasetConfig(
        system=system, definition=definition, substeps=4, count=360, samples_per_run=36
    )
    emulator = build_emulator(simulate_transitions(config), TrainingConfig(widths=(8, 8)))
    return request.param, emulator


def played(env_id: str, seed: int) -> list[tuple[Any, ...]]:
    """Return (state, action, state after it, observation, reward, terminated) of steps of the environment itself."""
    env = gymnasium.make(env_id)
    env.reset(seed=seed)
    env.action_space.seed(seed)
    rows = []
    is_over = False
    while not is_over and len(rows) < STEPS:
        before = mujoco_state(env, None)
        action = env.action_space.sample()
        observation, reward, terminated, is_over, _ = env.step(action)
        is_over = is_over or terminated
        rows.append((before, action, mujoco_state(env, None), observation, reward, terminated))
    env.close()
    return rows


def test_the_rules_of_an_environment_pay_show_and_end_what_the_environment_does(task: Any):
    env_id, emulator = task
    rules = RULES[env_id](emulator)
    rows = [row for seed in range(4) for row in played(env_id, seed)]
    states, actions, following, observations, rewards, terminated = map(
        np.array, zip(*rows, strict=True)
    )
    paid = rules.reward(states, actions, following, emulator.dt)
    np.testing.assert_allclose(paid, rewards, atol=1e-9)
    np.testing.assert_array_equal(rules.observe(following), observations)
    np.testing.assert_array_equal(rules.is_over(following), terminated)
    assert terminated.any() == (env_id == "Hopper-v5")
    assert np.ptp(rewards) > 0.1


def test_on_the_physics_the_rules_are_the_environment(task: Any):
    env_id, emulator = task
    rows = played(env_id, 3)
    env = PhysicsVectorEnv(emulator, rules=RULES[env_id](emulator))
    env.reset(options={"state": rows[0][0]})
    for _, action, following, observation, reward, terminated in rows:
        shown, paid, is_over, _, _ = env.step(action[None])
        np.testing.assert_allclose(env.rows.states[0], following, atol=1e-6)
        np.testing.assert_allclose(shown[0], observation, atol=1e-5)
        assert paid[0] == pytest.approx(reward, abs=1e-6)
        assert is_over[0] == terminated


def test_starts_are_drawn_as_the_environment_draws_them(task: Any):
    env_id, emulator = task
    rules = RULES[env_id](emulator)
    random = np.random.default_rng(0)
    drawn = np.stack([rules.draw_start(random) for _ in range(400)])
    env = gymnasium.make(env_id)
    theirs = []
    for seed in range(400):
        env.reset(seed=seed)
        theirs.append(mujoco_state(env, None))
    env.close()
    reach = np.ptp(theirs, axis=0)
    np.testing.assert_allclose(drawn.mean(axis=0), np.mean(theirs, axis=0), atol=0.1 * reach.max())
    np.testing.assert_allclose(np.ptp(drawn, axis=0), reach, rtol=0.05)


def test_an_emulator_with_rules_has_the_spaces_of_the_environment(task: Any):
    env_id, emulator = task
    ours = EmulatorVectorEnv(emulator, 3, rules=RULES[env_id](emulator))
    theirs = gymnasium.make(env_id)
    assert ours.single_observation_space.shape == theirs.observation_space.shape
    assert ours.single_action_space == theirs.action_space
    assert ours.rows.steps == theirs.spec.max_episode_steps
    theirs.close()


def test_rules_and_a_reward_together_are_refused(shipped: Emulator):
    rules = EpisodeRules(lambda states, controls, following, dt: states[:, 0])
    with pytest.raises(NeuroAnimatorError, match="reward and rules: got both. Give one"):
        EmulatorVectorEnv(shipped, rules=rules, reward=max)


def test_a_step_beyond_the_trust_limit_ends_the_episode_and_no_other_does(shipped: Emulator):
    fast = np.array([0, 0, 0, 1.1 * float(shipped.domain.high[0]), 0, 0])
    still = np.zeros(6)
    for limit in (1.0, np.inf):
        env = EmulatorVectorEnv(shipped, 2, trust_limit=limit)
        env.reset(options={"state": np.stack([fast, still])})
        _, _, terminated, _, info = env.step(np.zeros((2, 3)))
        assert info["trust"][0] > 1 > info["trust"][1]
        assert terminated.tolist() == [limit == 1.0, False]


def test_the_penalty_is_in_proportion_to_how_far_a_step_is_beyond_the_edge(shipped: Emulator):
    fast = np.array([0, 0, 0, 1.1 * float(shipped.domain.high[0]), 0, 0])
    states = np.stack([fast, np.zeros(6)])
    earned = []
    for penalty in (0.0, 0.5):
        env = EmulatorVectorEnv(shipped, 2, trust_penalty=penalty)
        env.reset(options={"state": states})
        _, rewards, _, _, info = env.step(np.zeros((2, 3)))
        earned.append(rewards)
    lost = earned[0] - earned[1]
    assert lost[0] == pytest.approx(0.5 * (info["trust"][0] - 1), rel=1e-4)
    assert lost[1] == 0


@pytest.mark.parametrize("choice", [{"trust_limit": 0.0}, {"trust_penalty": -1.0}])
def test_a_guard_that_makes_no_sense_is_refused(shipped: Emulator, choice: dict[str, float]):
    with pytest.raises(NeuroAnimatorError, match="trust_limit and trust_penalty: wanted"):
        EmulatorVectorEnv(shipped, **choice)


def test_on_the_physics_and_in_its_emulator_episodes_begin_alike_and_stay_close(shipped: Emulator):
    actions = np.random.default_rng(0).uniform(-5, 5, (10, 3, 3))
    ends = []
    for kind in (EmulatorVectorEnv, PhysicsVectorEnv):
        env = kind(shipped, 3)
        first, _ = env.reset(seed=4)
        states = [env.step(action)[0] for action in actions]
        ends.append((first, states))
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    assert np.abs(np.array(ends[0][1]) - ends[1][1]).max() < 0.1 * np.ptp(ends[1][1])


def test_rows_that_end_start_anew_in_the_same_step_if_asked_to(shipped: Emulator):
    seconds = 3 * shipped.dt
    at_once = EmulatorVectorEnv(shipped, 2, seconds=seconds, autoreset_mode=AutoresetMode.SAME_STEP)
    plain = EmulatorVectorEnv(shipped, 2, seconds=seconds)
    assert at_once.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    np.testing.assert_array_equal(at_once.reset(seed=7)[0], plain.reset(seed=7)[0])
    control = np.tile(0.5 * np.array(shipped.bounds.high), (2, 1))
    for step in range(3):
        ours = at_once.step(control)
        theirs = plain.step(control)
        for one, other in zip(ours[1:4], theirs[1:4], strict=True):
            np.testing.assert_array_equal(one, other)
        has_ended = ours[2] | ours[3]
        assert has_ended.all() == (step == 2)
        assert ("final_obs" in ours[4]) == (step == 2)
    assert ours[4]["_final_obs"].all()
    np.testing.assert_array_equal(np.stack(ours[4]["final_obs"]), theirs[0])
    following, *_ = plain.step(control)
    np.testing.assert_array_equal(ours[0], following)


def test_stable_baselines3_learns_in_an_emulator(shipped: Emulator):
    pytest.importorskip("stable_baselines3", reason="pip install stable-baselines3")
    from ppo import Rows
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    inside = EmulatorVectorEnv(shipped, 16, seconds=0.5, autoreset_mode=AutoresetMode.SAME_STEP)
    env = VecNormalize(Rows(inside))
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=128, n_epochs=1, seed=0, device="cpu")
    model.learn(512)
    assert model.num_timesteps == 512
    assert len(model.ep_info_buffer) > 10
