"""The tasks of `neuroanimator.learn.tasks` as Gymnasium environments, with goals, rewards and ends."""

from __future__ import annotations

from typing import final

from gymnasium.vector import AutoresetMode

from neuroanimator.gym.single_env import SingleEnv
from neuroanimator.gym.task_rows import TaskRows
from neuroanimator.gym.vector_env import RowsVectorEnv


@final
class TaskVectorEnv(RowsVectorEnv):
    """`num_envs` trials of a task at once; row i is a `TaskEnv` reset with seed + i."""

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        render_mode: str | None = None,
        *,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    ):
        """Make it from the name of a task, such as `fish-reach`."""
        super().__init__(TaskRows(task), num_envs, render_mode, autoreset_mode)


@final
class TaskEnv(SingleEnv):
    """One trial after another of a task, on its emulator; a step is a super step, actions are clipped to the bounds.

    An observation (O,), clipped to ±`batched_step.MAX_OBSERVATION`, holds in this order: the inputs of the emulator's network
    for the body (sines and cosines of angles; velocities, shape and activations in standard deviations of training); for
    systems with a position, the goal's position relative to the body, along its own axes, in body lengths or 10 m; the
    direction to go, and up, along the same axes; among obstacles, position (in 10 m) and direction in the world; last the
    remaining share of time.

    The reward is the decrease of J in the step, over J at the start: J is the task's own objective, as if everything
    stayed as it is until the end. So rewards sum to 1 - J/J(start), and the best return is the best controller. Success
    adds `task_rows.BONUS` to the reward, failure subtracts it.

    It is terminated by success or failure (a crash, an obstacle touched, far outside training), and truncated when time
    is up. `info["success"]` is whether it succeeded, `info["covered"]` whether training covered the step, `info["trial"]`
    the number of the trial.
    """

    def __init__(self, task: str, render_mode: str | None = None):
        """Make it from the name of a task, such as `fish-reach`."""
        super().__init__(TaskVectorEnv(task, 1, render_mode))
