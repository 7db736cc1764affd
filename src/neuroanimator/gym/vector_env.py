"""What the vector environments of emulators and of tasks have in common: spaces, actions, seeds and pictures."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Float, UInt8
from numpy.typing import ArrayLike

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.film.live import LiveCamera, checked_render_mode


class EmulatedVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` episodes of one emulator in one compiled call; a step is a super step.

    A row that has ended starts anew in the next step, whose action it ignores and whose reward is zero.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, emulator: Emulator, num_envs: int, render_mode: str | None):
        """Prepare everything but the observations; see `set_observation_space`.

        Raises ArgumentError for no rows, and for a render mode there is not.
        """
        if num_envs < 1:
            raise ArgumentError(f"num_envs: wanted one or more, came {num_envs}.")
        self.emulator = emulator
        self.num_envs = num_envs
        self.render_mode = checked_render_mode(render_mode)
        self.metadata = self.metadata | {"render_fps": round(1 / emulator.dt)}
        low = np.array(emulator.bounds.low, np.float32)
        high = np.array(emulator.bounds.high, np.float32)
        self.single_action_space = Box(low, high, dtype=np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._random = [np_random()[0] for _ in range(num_envs)]
        if self.render_mode is not None and not emulator.skeleton.bones:
            raise ArgumentError(
                f"render_mode: {emulator.system} has no bodies to draw, only numbers. Leave it out; 'animate' draws gauges."
            )
        self._camera = LiveCamera(emulator.spec)

    def set_observation_space(self, space: Box) -> None:
        """Let `space` be that of one row's observation."""
        self.single_observation_space = space
        self.observation_space = batch_space(space, self.num_envs)

    @abstractmethod
    def shown_states(self) -> Float[np.ndarray, "B S"]:
        """Return the states that pictures show."""

    def render(self) -> tuple[UInt8[np.ndarray, "H W 3"], ...] | None:
        """Return a picture of each row if `render_mode` is `rgb_array`; ResourceError without graphics."""
        if self.render_mode is None:
            return None
        return tuple(self._camera.picture(state) for state in self.shown_states())

    def close_extras(self, **_: Any) -> None:
        """Give the memory of pictures back."""
        self._camera.close()

    def _seed_rows(self, seed: int | None) -> None:
        """Let row i draw by `seed` + i; without a seed, rows go on drawing as they do."""
        if seed is not None:
            self._random = [np_random(seed + row)[0] for row in range(self.num_envs)]

    def _checked_actions(self, actions: ArrayLike) -> Float[np.ndarray, "B C"]:
        """Return `actions` (B, C), brought within the bounds as a motor would."""
        controls = self.emulator.control.check(actions, "action")
        if controls.shape != self.action_space.shape:
            raise ArgumentError(
                f"action: wanted shape {self.action_space.shape}, came {controls.shape}."
            )
        return self.emulator.bounds.clip(controls)


def check_reset_options(options: dict[str, Any] | None, valid: str) -> None:
    """Raise ArgumentError for an option of `reset` other than the `valid` one."""
    unknown = set(options or {}) - {valid}
    if unknown:
        raise ArgumentError(f"No reset option called '{unknown.pop()}'. Options: {valid}.")
