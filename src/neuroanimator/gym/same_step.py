"""Rows that start anew in the very step that ends them, with actions within ±1: what learners on many rows expect."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Bool, Float

from neuroanimator.errors import ArgumentError
from neuroanimator.gym.state_env import StateVectorEnv


class Stepped(NamedTuple):
    """What a step returns by stable-baselines3's protocol."""

    observations: Float[np.ndarray, "B O"]
    """Of rows that ended, the first of their next episode."""
    rewards: Float[np.ndarray, " B"]
    has_ended: Bool[np.ndarray, " B"]
    infos: list[dict[str, Any]]
    """Of rows that ended: last observation, whether time ended them, return and length, and what the environment says."""


class SameStepRows:
    """A vector environment by stable-baselines3's protocol, without needing it."""

    def __init__(self, env: StateVectorEnv):
        """Raises ArgumentError for an environment whose rows cannot be restarted."""
        if not isinstance(env, StateVectorEnv):
            raise ArgumentError(
                f"env: wanted an EmulatorVectorEnv or a PhysicsVectorEnv, came a {type(env).__name__}."
            )
        self.env = env
        low = env.single_action_space.low
        high = env.single_action_space.high
        self._middle = (low + high) / 2
        self._half = (high - low) / 2
        self.action_space = Box(-1.0, 1.0, low.shape, np.float32)
        self.observation_space = env.single_observation_space
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, int)

    def reset(self, seed: int | None = None) -> Float[np.ndarray, "B O"]:
        """Return the observations of new episodes."""
        self._returns[:] = 0
        self._lengths[:] = 0
        return self.env.reset(seed=seed)[0]

    def step(self, actions: Float[np.ndarray, "B C"]) -> Stepped:
        """Return what `actions`, each within ±1 for its bounds, come to; rows that end start anew."""
        controls = self._middle + self._half * np.clip(actions, -1.0, 1.0)
        observations, rewards, terminated, truncated, info = self.env.step(controls)
        has_ended = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.env.num_envs)]
        if not has_ended.any():
            return Stepped(observations, rewards.astype(np.float32), has_ended, infos)
        said = {name: values for name, values in info.items() if not name.startswith("_")}
        for row in np.flatnonzero(has_ended):
            infos[row] = {name: values[row].item() for name, values in said.items()}
            infos[row]["terminal_observation"] = observations[row]
            infos[row]["TimeLimit.truncated"] = bool(truncated[row] and not terminated[row])
            infos[row]["episode"] = {
                "r": float(self._returns[row]),
                "l": int(self._lengths[row]),
            }
        self._returns[has_ended] = 0
        self._lengths[has_ended] = 0
        following = self.env.restart(has_ended)
        return Stepped(following, rewards.astype(np.float32), has_ended, infos)
