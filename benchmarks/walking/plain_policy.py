"""Policies of stable-baselines3 as plain numbers, and what they earn in Gymnasium's environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float

MAX_NORMALISED = 10.0
"""What `VecNormalize` clips observations to."""

TINY = 1e-8
"""What it adds to variances."""


@dataclass(frozen=True)
class PlainPolicy:
    """A policy of stable-baselines3 in NumPy: judging shall not take as long as learning does."""

    weights: list[Float[np.ndarray, "O I"]]
    biases: list[Float[np.ndarray, " O"]]
    deviation: Float[np.ndarray, " C"]
    """Standard deviation of its actions while it learns."""
    is_rectified: bool
    """Whether units are rectified; else tanh."""
    mean: Float[np.ndarray, " I"]
    variance: Float[np.ndarray, " I"]
    """Of observations, as `VecNormalize` has them."""

    @classmethod
    def of(cls, model: Any, normaliser: Any) -> PlainPolicy:
        """Return that of a PPO model and the `VecNormalize` it learnt in."""
        tensors = model.policy.state_dict()
        names = [name for name in tensors if name.startswith("mlp_extractor.policy_net")]
        names += ["action_net.weight", "action_net.bias"]
        numbers = {name: tensors[name].numpy().astype(float) for name in names}
        return cls(
            [value for name, value in numbers.items() if name.endswith("weight")],
            [value for name, value in numbers.items() if name.endswith("bias")],
            np.exp(tensors["log_std"].numpy()),
            "ReLU" in repr(model.policy.mlp_extractor),
            normaliser.obs_rms.mean.copy(),
            normaliser.obs_rms.var.copy(),
        )

    def __call__(
        self, observations: Float[np.ndarray, "B I"], noise: Float[np.ndarray, "B C"] | float = 0.0
    ) -> Float[np.ndarray, "B C"]:
        """Return actions within ±1; `noise` in standard deviations."""
        values = (observations - self.mean) / np.sqrt(self.variance + TINY)
        values = np.clip(values, -MAX_NORMALISED, MAX_NORMALISED)
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = values @ weights.T + biases
            values = np.maximum(values, 0) if self.is_rectified else np.tanh(values)
        mean = values @ self.weights[-1].T + self.biases[-1]
        return np.clip(mean + noise * self.deviation, -1.0, 1.0)


def gymnasium_returns(
    policy: Callable[[Float[np.ndarray, "B I"]], Float[np.ndarray, "B C"]],
    env_id: str,
    seeds: range,
) -> list[float]:
    """Return what a policy's mean actions come to in Gymnasium's environment itself."""
    env = gymnasium.make(env_id)
    returns = []
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        total = 0.0
        is_over = False
        while not is_over:
            action = policy(np.asarray(observation)[None])[0]
            observation, reward, terminated, truncated, _ = env.step(action)
            total += float(reward)
            is_over = terminated or truncated
        returns.append(total)
    env.close()
    return returns
