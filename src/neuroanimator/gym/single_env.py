"""A single environment as the one row of a vector environment, so that both behave exactly alike."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import ArrayLike

from neuroanimator.gym.vector_env import RowsVectorEnv


class SingleEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """The one row of a vector environment, without the axis of rows."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(self, vector_env: RowsVectorEnv):
        """Make it from a vector environment of one row."""
        self.vector_env = vector_env
        self.render_mode = vector_env.render_mode
        self.metadata = self.metadata | {"render_fps": vector_env.metadata["render_fps"]}
        self.observation_space = vector_env.single_observation_space
        self.action_space = vector_env.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, " O"], dict[str, Any]]:
        """Return (observation, info) of a random start, the same for the same seed, or of the start in `options`."""
        super().reset(seed=seed)
        self.vector_env.random = [self.np_random]
        observations, info = self.vector_env.reset(options=options)
        return observations[0], _first_row(info)

    def step(
        self, action: ArrayLike
    ) -> tuple[Float[np.ndarray, " O"], float, bool, bool, dict[str, Any]]:
        """Return (observation, reward, terminated, truncated, info) after holding `action` (C,) for a super step."""
        made = self.vector_env.step(np.asarray(action)[None])
        (observation,), (reward,), (terminated,), (truncated,), info = made
        return observation, float(reward), bool(terminated), bool(truncated), _first_row(info)

    def render(self) -> UInt8[np.ndarray, "H W 3"] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a picture if `render_mode` is `rgb_array`; ResourceError if none can be drawn."""
        pictures = self.vector_env.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Free the memory of pictures."""
        self.vector_env.close()


def _first_row(info: dict[str, Any]) -> dict[str, Any]:
    """Return the first row of a vector environment's `info`, without the masks."""
    return {name: rows[0].item() for name, rows in info.items() if not name.startswith("_")}
