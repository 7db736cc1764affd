"""What the benchmark of reinforcement learning rests on: the truck's rules, and policies that are what PPO learnt."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium_rules import BAY, BAY_HEADING, LANE_NOISE, LANE_START, parking_rules

import neuroanimator as na
from neuroanimator.gym import EmulatorVectorEnv, EpisodeRules, PhysicsVectorEnv
from neuroanimator.state.rotation import facing


@pytest.fixture(scope="module")
def truck() -> na.Emulator:
    return na.load_emulator("truck-50")


@pytest.fixture(scope="module")
def rules(truck: na.Emulator) -> EpisodeRules:
    return parking_rules(truck)


def truck_at(truck: na.Emulator, position: np.ndarray, heading: float) -> np.ndarray:
    state = truck.rest
    state[:2] = position
    state[3:7] = facing(np.array(heading))
    return state


def test_standing_in_the_bay_pays_most_and_coming_nearer_pays_what_it_is_nearer(
    truck: na.Emulator, rules: EpisodeRules
):
    parked = truck_at(truck, BAY, BAY_HEADING)
    before = truck_at(truck, BAY + np.array([0, 3.0]), BAY_HEADING)
    aslant = truck_at(truck, BAY, BAY_HEADING + 0.5)
    still = np.zeros((1, truck.control.size))

    def paid(state: np.ndarray, following: np.ndarray) -> float:
        return float(rules.reward(state[None], still, following[None], truck.dt)[0])

    assert paid(parked, parked) == pytest.approx(truck.dt)
    assert paid(aslant, aslant) < truck.dt
    assert paid(before, parked) + paid(parked, before) == pytest.approx(
        paid(before, before) + paid(parked, parked)
    )
    assert paid(before, parked) == pytest.approx(3.0 / 5.0 + truck.dt)


def test_what_is_observed_and_paid_does_not_depend_on_who_drives_the_truck(
    truck: na.Emulator, rules: EpisodeRules
):
    action = np.tile([[1500.0, -0.3]], (4, 1))
    seen = []
    for kind in (EmulatorVectorEnv, PhysicsVectorEnv):
        env = kind(truck, 4, rules=rules)
        first, _ = env.reset(seed=2)
        steps = [env.step(action)[:2] for _ in range(10)]
        seen.append((first, steps[-1][0], sum(rewards for _, rewards in steps)))
    np.testing.assert_allclose(seen[0][0], seen[1][0], atol=1e-6)
    np.testing.assert_allclose(seen[0][1], seen[1][1], atol=0.05)
    np.testing.assert_allclose(seen[0][2], seen[1][2], atol=0.05)


def test_starts_lie_in_the_lane_and_touch_nothing_and_an_obstacle_ends_the_episode(
    truck: na.Emulator, rules: EpisodeRules
):
    assert rules.draw_start is not None
    rng = np.random.default_rng(0)
    starts = np.stack([rules.draw_start(rng) for _ in range(200)])
    assert (np.abs(starts[:, :2] - LANE_START) <= LANE_NOISE[:2]).all()
    assert not rules.is_over(starts).any()
    on_a_post = truck_at(truck, np.array([-8.0, 0.0]), 0.0)
    lost = truck_at(truck, np.array([-30.0, 0.0]), 0.0)
    assert rules.is_over(np.stack([on_a_post, lost])).all()


def test_the_clock_of_learning_stands_still_while_policies_are_judged(shipped: na.Emulator):
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is missing: an extra, [rl]")
    from benchmarks.walking.plain_policy import PlainPolicy
    from benchmarks.walking.ppo import Learning, learn, rows_world

    now = [0.0]
    judged = []
    learning = Learning(8, 0.99, {"n_steps": 16, "batch_size": 64, "n_epochs": 1})
    world = rows_world(EmulatorVectorEnv(shipped, 8, seconds=1.0))

    def clock() -> float:
        now[0] += 0.01
        return now[0]

    def judge(policy: PlainPolicy) -> tuple[float, float]:
        judged.append(policy)
        now[0] += 100.0
        return 0.0, 0.0

    learnt = learn(world, learning, 0, judge, np.inf, 1.0, clock=clock)
    assert len(judged) == len(learnt.points) > 1
    assert 1.0 <= learnt.seconds < 2.0
    assert learnt.stepping_seconds == pytest.approx(0.01 * learnt.samples / 8, abs=0.02)


def test_a_plain_policy_is_the_mean_action_of_the_model(shipped: na.Emulator):
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is missing: an extra, [rl]")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from benchmarks.walking.plain_policy import PlainPolicy
    from benchmarks.walking.ppo import rows_world

    env = VecNormalize(rows_world(EmulatorVectorEnv(shipped, 8, seconds=1.0)))
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=64, seed=0, device="cpu")
    model.learn(512)
    observations = np.random.default_rng(0).normal(size=(50, 6)).astype(np.float32)
    theirs, _ = model.predict(env.normalize_obs(observations), deterministic=True)
    np.testing.assert_allclose(PlainPolicy.of(model, env)(observations), theirs, atol=1e-4)
