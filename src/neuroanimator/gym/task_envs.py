"""The tasks of `neuroanimator.control.tasks` as Gymnasium environments: a goal, a reward on the way, an end."""

from __future__ import annotations

from typing import final

from neuroanimator.gym.single_env import SingleEnv
from neuroanimator.gym.task_rows import TaskRows
from neuroanimator.gym.vector_env import RowsVectorEnv


@final
class TaskVectorEnv(RowsVectorEnv):
    """`num_envs` trials of a task at once; row i is a `TaskEnv` reset with seed + i.

    A row that has ended starts anew in the next step, whose action it ignores and whose reward is zero.
    """

    def __init__(self, task: str, num_envs: int = 1, render_mode: str | None = None):
        """Make it from the name of a task, such as `fish-reach`."""
        super().__init__(TaskRows(task), num_envs, render_mode)


@final
class TaskEnv(SingleEnv):
    """One trial after another of a task, on its emulator; a step is a super step, actions are clipped to the bounds.

    An observation (O,), kept within ±`batched_step.MAX_OBSERVATION`, holds in this order: what the emulator's network sees of the
    body (sines and cosines of angles; velocities, shape and activations in standard deviations of training), then for
    systems that have a position: the goal's position as seen from the body, along its own axes, in body lengths or
    10 m; the direction to go along the same axes; up along the same axes; among obstacles, position (in 10 m) and
    direction in the world; last the share of time that is left.

    The reward is by how much the step lowered J, over J at the start: J is the task's own objective, taken as if
    everything stayed as it is until the end. So rewards sum to 1 - J/J(start), and the best return is the best
    controller. The step that succeeds gets `task_rows.BONUS` more, the one that fails so much less.

    It is terminated by success, by failure (a crash, an obstacle touched, far outside training), and truncated when
    time is up. `info["success"]` says which, `info["covered"]` whether training covered the step, `info["trial"]` the
    number of the trial.
    """

    def __init__(self, task: str, render_mode: str | None = None):
        """Make it from the name of a task, such as `fish-reach`."""
        super().__init__(TaskVectorEnv(task, 1, render_mode))
