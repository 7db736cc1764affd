"""Emulators, and the physics they stand for, as Gymnasium environments: rules define observations and rewards."""

from __future__ import annotations

from pathlib import Path
from typing import final

import numpy as np
from gymnasium.vector import AutoresetMode

from neuroanimator.control.objective.objective import Objective
from neuroanimator.emulator.emulator import Emulator, as_emulator
from neuroanimator.gym.rules import EpisodeRules, Reward, rules_by
from neuroanimator.gym.single_env import SingleEnv
from neuroanimator.gym.state_rows import NOISE, EmulatorStepper, StateRows, physics_stepper
from neuroanimator.gym.vector_env import RowsVectorEnv
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.systems.system import Scheme


@final
class EmulatorVectorEnv(RowsVectorEnv):
    """`num_envs` emulated systems in one compiled call; row i is an `EmulatorEnv` reset with seed + i."""

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
        trust_limit: float = np.inf,
        trust_penalty: float = 0.0,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    ):
        """Take the arguments of an `EmulatorEnv`; `autoreset_mode` says when a row that has ended restarts."""
        emulator = as_emulator(emulator)
        chosen = rules_by(emulator, objective, reward, rules)
        stepper = EmulatorStepper(emulator, trust_limit, trust_penalty)
        rows = StateRows(emulator, stepper, chosen, seconds, noise)
        super().__init__(rows, num_envs, render_mode, autoreset_mode)


@final
class PhysicsVectorEnv(RowsVectorEnv):
    """`EmulatorVectorEnv` on the physics that an emulator stands for, on every core: the same rules, starts and actions.

    The physics is stepped by its default scheme (`System.scheme`) unless another `scheme` is given. An episode ends where
    the physics diverges. `info` is empty. Policies learnt in an emulator are evaluated here.
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
        """Take the arguments of an `EmulatorEnv`.

        Raises ArgumentError or BadFileError if there is no physics: for recordings, and for files that are not allowed.
        """
        emulator = as_emulator(emulator)
        chosen = rules_by(emulator, objective, reward, rules)
        system = system_of(emulator)
        stepper = physics_stepper(system, scheme or system.scheme, emulator.dt)
        rows = StateRows(emulator, stepper, chosen, seconds, noise)
        super().__init__(rows, num_envs, render_mode, autoreset_mode)


@final
class EmulatorEnv(SingleEnv):
    """One emulated system; a step is a super step, an observation the state, an action the control, SI units.

    An episode starts near rest, or at the state of `reset(options={"state": ...})`. It is truncated after `seconds`, and
    terminated where the state is NaN or far (`batched_step.FAR`) outside the training data. `info["trust"]` is the
    distance of the step from these, `info["covered"]` whether it is within their edge, 1. Actions are clipped to the
    bounds. Observations are unbounded, since a free body may go anywhere: `emulator.state` names each number and its
    unit. The tasks of `task_envs` observe the body in its own frame, within bounds.
    """

    def __init__(
        self,
        emulator: Emulator | str | Path,
        objective: Objective | None = None,
        reward: Reward | None = None,
        seconds: float | None = None,
        noise: float = NOISE,
        render_mode: str | None = None,
        *,
        rules: EpisodeRules | None = None,
        trust_limit: float = np.inf,
        trust_penalty: float = 0.0,
    ):
        """Make it from an emulator, its file, or a shipped one's name.

        The reward is the `RunningCost` of `objective`, or that of `reward`. `rules` also define observations, and where
        episodes begin and end. An episode is also terminated by a step whose trust score is above `trust_limit`, and
        each step loses `trust_penalty` times the excess of its score over the edge of training, 1.
        """
        super().__init__(
            EmulatorVectorEnv(
                emulator,
                1,
                objective,
                reward,
                seconds,
                noise,
                render_mode,
                rules=rules,
                trust_limit=trust_limit,
                trust_penalty=trust_penalty,
            )
        )
