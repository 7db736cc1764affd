"""Learn a policy by PPO of stable-baselines3 inside an emulator, and judge it on the true physics.

pip install "neuroanimator[gym]" stable-baselines3; then: python ppo.py
"""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

import neuroanimator as na
from neuroanimator.gym import EmulatorVectorEnv, PhysicsVectorEnv


class Rows(VecEnv):
    """A vector environment of Gymnasium's protocol, same-step autoreset, as a `VecEnv`; actions within ±1."""

    def __init__(self, env: EmulatorVectorEnv | PhysicsVectorEnv):
        assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
        space = env.single_action_space
        self.env = env
        self.render_mode = None
        self._middle = (space.low + space.high) / 2
        self._half = (space.high - space.low) / 2
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, int)
        unit = Box(-1.0, 1.0, space.shape, np.float32)
        super().__init__(env.num_envs, env.single_observation_space, unit)

    def reset(self):
        self._returns[:] = 0
        self._lengths[:] = 0
        first_seed = self._seeds[0]
        self._reset_seeds()
        return self.env.reset(seed=first_seed)[0]

    def step_async(self, actions):
        self._controls = self._middle + self._half * np.clip(actions, -1, 1)

    def step_wait(self):
        observations, rewards, terminated, truncated, info = self.env.step(self._controls)
        has_ended = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos = [{} for _ in has_ended]
        for row in np.flatnonzero(has_ended):
            infos[row]["terminal_observation"] = info["final_obs"][row]
            infos[row]["TimeLimit.truncated"] = bool(truncated[row] and not terminated[row])
            infos[row]["episode"] = {"r": self._returns[row], "l": self._lengths[row], "t": 0}
        self._returns[has_ended] = 0
        self._lengths[has_ended] = 0
        return observations, rewards.astype(np.float32), has_ended, infos

    def close(self):
        self.env.close()

    def get_attr(self, attr_name, indices=None):
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name, value, indices=None):
        setattr(self.env, attr_name, value)

    def env_method(self, method_name, *arguments, indices=None, **named):
        result = getattr(self.env, method_name)(*arguments, **named)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False for _ in self._get_indices(indices)]


def mean_return(model: PPO, normaliser: VecNormalize, judge: Rows) -> float:
    """Return what the policy's mean actions earn in an episode of each row."""
    observations, returns = judge.reset(), []
    while len(returns) < judge.num_envs:
        actions, _ = model.predict(normaliser.normalize_obs(observations), deterministic=True)
        observations, _, _, infos = judge.step(actions)
        returns += [info["episode"]["r"] for info in infos if "episode" in info]
    return float(np.mean(returns))


if __name__ == "__main__":
    upright = na.Objective.of(na.effort(), na.goal(na.load_system("pendulum"), "upright"))
    mode = AutoresetMode.SAME_STEP
    inside = EmulatorVectorEnv("pendulum", 256, upright, trust_limit=3.0, autoreset_mode=mode)
    env = VecNormalize(Rows(inside))
    judge = Rows(PhysicsVectorEnv("pendulum", 64, upright, autoreset_mode=mode))
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=2048, n_epochs=4, device="cpu")
    print(f"mean return on MuJoCo before learning: {mean_return(model, env, judge):.1f}")
    model.learn(1_000_000)
    print(f"mean return on MuJoCo after learning: {mean_return(model, env, judge):.1f}")
