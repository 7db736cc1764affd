"""The same episodes on the true physics: where a policy that was learnt in an emulator is judged."""

from __future__ import annotations

from pathlib import Path
from typing import final

import numpy as np
from gymnasium.vector import AutoresetMode
from jaxtyping import Bool, Float

from neuroanimator.control.objective.objective import Objective
from neuroanimator.emulator.emulator import Emulator, as_emulator
from neuroanimator.evaluation.held_out import system_of
from neuroanimator.gym.envs import Reward, rules_by
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.gym.state_env import NOISE, Leap, StateVectorEnv
from neuroanimator.systems.system import Scheme


@final
class PhysicsVectorEnv(StateVectorEnv):
    """`EmulatorVectorEnv` on the physics that an emulator stands for, on every core: the same rules, starts and actions.

    The physics is stepped as its users would (`System.scheme`) if no other `scheme` is given. An episode ends where the
    physics diverges. `info` is empty.
    """

    def __init__(
        self,
        emulator: Emulator | str | Path,
        num_envs: int = 1,
        objective: Objective | None = None,
        reward: Reward | None = None,
        seconds: float | None = None,
        noise: float = NOISE,
        render_mode: str | None = None,
        *,
        rules: EpisodeRules | None = None,
        scheme: Scheme | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    ):
        """Make it from what an `EmulatorEnv` is made from.

        Raises ArgumentError or BadFileError where there is no physics: of recordings, and of files that are not allowed.
        """
        emulator = as_emulator(emulator)
        self.system = system_of(emulator)
        self.scheme = scheme or self.system.scheme
        self.scheme.steps(emulator.dt)  # refuses a super step that is no whole number of steps
        super().__init__(
            emulator,
            num_envs,
            rules_by(emulator, objective, reward, rules),
            seconds,
            noise,
            render_mode,
            autoreset_mode,
        )

    def begin_rows(
        self, states: Float[np.ndarray, "B S"], rows: Bool[np.ndarray, " B"]
    ) -> Float[np.ndarray, "B S"]:
        return states.astype(float)

    def leap(self, states: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B C"]) -> Leap:
        held = controls[:, None].astype(float)
        runs = self.system.simulate_fastest(states, held, self.emulator.dt, self.scheme)
        following = np.where(runs.has_diverged[:, None], states, runs.states[:, 1])
        return Leap(following, runs.has_diverged, np.zeros(len(states)), {})
