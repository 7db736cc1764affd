"""Emulators as environments of stable-baselines3. Needs the extra `[rl]`.

from stable_baselines3 import PPO
from neuroanimator.gym import EmulatorVectorEnv, StableBaselinesEnv

env = StableBaselinesEnv(EmulatorVectorEnv("swimmer.emulator.safetensors", 1024, rules="Swimmer-v5"))
PPO("MlpPolicy", env).learn(1_000_000)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from neuroanimator.errors import ResourceError
from neuroanimator.gym.same_step import SameStepRows
from neuroanimator.gym.state_env import StateVectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv  # pyright: ignore[reportMissingImports]
except ImportError:
    raise ResourceError(
        "stable-baselines3 is missing. Install it with: pip install 'neuroanimator[rl]'"
    ) from None


class StableBaselinesEnv(VecEnv):
    """An `EmulatorVectorEnv` or a `PhysicsVectorEnv` as a `VecEnv`: all rows at once, actions within ±1 for their bounds.

    stable-baselines3 takes no vector environment of Gymnasium's. Infos of rows that ended hold the return and length of
    the episode, as those of its `VecMonitor` do.
    """

    def __init__(self, env: StateVectorEnv):
        """Make it from a vector environment."""
        self.rows = SameStepRows(env)
        self.render_mode = env.render_mode
        super().__init__(env.num_envs, self.rows.observation_space, self.rows.action_space)
        self._actions = np.zeros((env.num_envs, *self.rows.action_space.shape), np.float32)
        self._next_seed: int | None = None

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Let row i draw by `seed` + i from the next reset on."""
        self._next_seed = seed
        return [None if seed is None else seed + row for row in range(self.num_envs)]

    def reset(self) -> np.ndarray:
        """Return the observations (B, O) of new episodes."""
        observations = self.rows.reset(self._next_seed)
        self._next_seed = None
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions (B, C) of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Return (observations, rewards, whether rows ended, infos)."""
        stepped = self.rows.step(self._actions)
        return stepped.observations, stepped.rewards, stepped.has_ended, stepped.infos

    def close(self) -> None:
        """End the drawing process."""
        self.rows.env.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return a picture of each row."""
        return list(self.rows.env.render() or [])

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the vector environment, the same for each row."""
        value = getattr(self.rows.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the vector environment, for all rows."""
        setattr(self.rows.env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Return what a method of the vector environment returns, the same for each row."""
        result = getattr(self.rows.env, method_name)(*method_args, **method_kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return that no row is wrapped."""
        return [False for _ in self._get_indices(indices)]
