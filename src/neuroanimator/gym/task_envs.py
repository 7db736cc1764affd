"""The tasks of `neuroanimator.tasks` as Gymnasium environments: a goal, a reward on the way, an end."""

from __future__ import annotations

from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.episodes import start_episodes, step_episodes
from neuroanimator.gym.rows import MAX_OBSERVATION, Aims, Observer, observe_rows
from neuroanimator.gym.single_env import SingleEnv
from neuroanimator.gym.vector_env import EmulatedVectorEnv, check_reset_options
from neuroanimator.state.arrays import AnyArray
from neuroanimator.systems import load_system
from neuroanimator.tasks.rigid import RIGID_TASKS
from neuroanimator.tasks.swimmers import SWIMMER_TASKS
from neuroanimator.tasks.task import Task, Trial
from neuroanimator.zoo import emulator_name

TASKS = {task.name: task for task in (*RIGID_TASKS, *SWIMMER_TASKS)}
"""The tasks by name."""

TRIALS = 100
"""Number of starts and goals an episode is drawn from: the same ones `benchmarks/control.py` solves."""

TRIAL_STREAM = 5
"""Tells the random numbers of a trial from others of the same number: that of the benchmark."""

RIGID_SCALE = 10.0
"""Length in which distances to the goal are counted by what is not deformable [m]: about as far as truck and lander
go."""

BONUS = 1.0
"""What is added to the reward of the step that succeeds, and taken from that of the one that fails."""


@final
class TaskVectorEnv(EmulatedVectorEnv):
    """`num_envs` trials of a task at once; row i is a `TaskEnv` reset with seed + i.

    A row that has ended starts anew in the next step, whose action it ignores and whose reward is zero.
    """

    def __init__(self, task: str, num_envs: int = 1, render_mode: str | None = None):
        """Make it from the name of a task, such as `fish-reach`."""
        if task not in TASKS:
            raise ArgumentError(f"No task called '{task}'. Tasks: {', '.join(TASKS)}.")
        self.task: Task = TASKS[task]
        emulator = Emulator.load(emulator_name(self.task.system, self.task.substeps))
        super().__init__(emulator, num_envs, render_mode)
        self.system = load_system(self.task.system)
        self.steps = round(self.task.seconds / emulator.dt)
        self._drawn: dict[int, Trial] = {}
        self._begin([0] * num_envs)
        scale = self.system.body_length or RIGID_SCALE
        self._observer = Observer(emulator, scale, self._trials[0].aim.is_in_a_fixed_world)
        size = self._observe().shape[1]
        self.set_observation_space(Box(-MAX_OBSERVATION, MAX_OBSERVATION, (size,), np.float32))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, "B O"], dict[str, Any]]:
        """Return (observations, info) of random trials, or of those numbered in `options["trial"]`."""
        self._seed_rows(seed)
        check_reset_options(options, "trial")
        numbers = [draw_number(rng) for rng in self._random]
        if options:
            asked = _checked_numbers(options["trial"])
            numbers = np.broadcast_to(asked, self.num_envs).tolist()
        self._begin(numbers)
        info = {"trial": np.array(self._numbers), "_trial": np.ones(self.num_envs, bool)}
        return self._observe(), info

    def step(
        self, actions: ArrayLike
    ) -> tuple[
        Float[np.ndarray, "B O"],
        Float[np.ndarray, " B"],
        Bool[np.ndarray, " B"],
        Bool[np.ndarray, " B"],
        dict[str, Any],
    ]:
        """Return (observations, rewards, terminated, truncated, info) after `actions` (B, C) were held for a super step."""
        is_new = self._has_ended
        episodes, rewards, trust, is_far = step_episodes(
            self.emulator,
            self._objectives,
            self._episodes,
            self._steps,
            self._checked_actions(actions).astype(np.float32),
        )
        self._steps = self._steps + 1
        self._episodes = episodes
        has_succeeded, has_failed = self._judge(~is_new, is_far)
        earned = np.nan_to_num(rewards) + BONUS * has_succeeded - BONUS * has_failed
        self._restart(np.flatnonzero(is_new))
        terminated = has_succeeded | has_failed
        truncated = (self._steps >= self.steps) & ~terminated
        self._has_ended = terminated | truncated
        info = {
            "covered": (trust <= EDGE) & ~is_new,
            "trust": trust,
            "success": has_succeeded,
            "trial": np.array(self._numbers),
        }
        masks = {f"_{name}": ~is_new for name in info}
        return (
            self._observe(),
            np.where(is_new, 0.0, earned),
            terminated,
            truncated,
            info | masks,
        )

    def shown_states(self) -> Float[np.ndarray, "B S"]:
        states = self._episodes.states
        return states[np.arange(self.num_envs), self._steps]

    def _judge(
        self, is_running: Bool[np.ndarray, " B"], is_far: Bool[np.ndarray, " B"]
    ) -> tuple[Bool[np.ndarray, " B"], Bool[np.ndarray, " B"]]:
        """Return which of the rows that are running have succeeded, and which have failed."""
        has_succeeded = np.zeros(self.num_envs, bool)
        has_failed = np.zeros(self.num_envs, bool)
        states = np.asarray(self._episodes.states, float)
        for row in np.flatnonzero(is_running):
            trial = self._trials[row]
            path = states[row, : self._steps[row] + 1]
            has_succeeded[row] = np.isfinite(path).all() and trial.is_success(path)
            is_lost = not has_succeeded[row] and trial.has_failed(path)
            has_failed[row] = bool(is_far[row]) or is_lost
        return has_succeeded, has_failed

    def _begin(self, numbers: list[int]) -> None:
        """Begin the trials of these numbers, one a row."""
        self._numbers = list(numbers)
        self._trials = [self._draw(number) for number in numbers]
        self._steps = np.zeros(self.num_envs, int)
        self._has_ended = np.zeros(self.num_envs, bool)
        self._objectives = _stacked([trial.objective for trial in self._trials])
        self._aims = Aims.of([trial.aim for trial in self._trials])
        starts = np.stack([np.asarray(trial.start, float) for trial in self._trials])
        self._episodes = start_episodes(self.emulator, self._objectives, starts, self.steps)

    def _restart(self, rows: Int[np.ndarray, " R"]) -> None:
        """Begin a new trial in each of `rows`, and let the others be."""
        if not len(rows):
            return
        steps = self._steps
        before = (self._episodes, self._objectives, self._aims)
        numbers = list(self._numbers)
        for row in rows:
            numbers[row] = draw_number(self._random[row])
        self._begin(numbers)
        goes_on = ~np.isin(np.arange(self.num_envs), rows)

        def pick(old: AnyArray, new: AnyArray) -> AnyArray:
            where = np.where if isinstance(new, np.ndarray) else jnp.where
            return where(goes_on.reshape(-1, *(1,) * (new.ndim - 1)), old, new)

        after = (self._episodes, self._objectives, self._aims)
        self._episodes, self._objectives, self._aims = jax.tree.map(pick, before, after)
        self._steps = np.where(goes_on, steps, 0)

    def _draw(self, number: int) -> Trial:
        """Return the trial of that number: always the same one, and that of the benchmark."""
        if number not in self._drawn:
            rng = np.random.default_rng([number, TRIAL_STREAM])
            self._drawn[number] = self.task.draw(self.system, rng, self.steps, self.emulator.dt)
        return self._drawn[number]

    def _observe(self) -> Float[np.ndarray, "B O"]:
        time_left = 1 - self._steps / self.steps
        return observe_rows(self._observer, self._episodes.latent, self._aims, time_left)


@final
class TaskEnv(SingleEnv):
    """One trial after another of a task, on its emulator; a step is a super step, actions are clipped to the bounds.

    An observation (O,), kept within ±`MAX_OBSERVATION`, holds in this order: what the emulator's network sees of the
    body (sines and cosines of angles; velocities, shape and activations in standard deviations of training), then for
    systems that have a position: the goal's position as seen from the body, along its own axes, in body lengths or
    10 m; the direction to go along the same axes; up along the same axes; among obstacles, position (in 10 m) and
    direction in the world; last the share of time that is left.

    The reward is by how much the step lowered J, over J at the start: J is the task's own objective, taken as if
    everything stayed as it is until the end. So rewards sum to 1 - J/J(start), and the best return is the best
    controller. The step that succeeds gets `BONUS` more, the one that fails so much less.

    It is terminated by success, by failure (a crash, an obstacle touched, far outside training), and truncated when
    time is up. `info["success"]` says which, `info["covered"]` whether training covered the step, `info["trial"]` the
    number of the trial.
    """

    def __init__(self, task: str, render_mode: str | None = None):
        """Make it from the name of a task, such as `fish-reach`."""
        self._row = TaskVectorEnv(task, 1, render_mode)
        super().__init__(self._row)

    def draw_start(self) -> dict[str, Any]:
        return {"trial": draw_number(self.np_random)}


def draw_number(rng: np.random.Generator) -> int:
    """Return the number of a random trial."""
    return int(rng.integers(TRIALS))


def _checked_numbers(trial: ArrayLike) -> Int[np.ndarray, " ..."]:
    """Return the number of a trial, or those of each row, as an array; ArgumentError if there are no such trials."""
    numbers = np.asarray(trial)
    is_whole = numbers.ndim <= 1 and numbers.dtype.kind in "iu"
    if not is_whole or not ((numbers >= 0) & (numbers < TRIALS)).all():
        raise ArgumentError(f"trial: wanted numbers from 0 to {TRIALS - 1}, came {trial}.")
    return numbers


def _stacked(rows: list[Any]) -> Any:
    """Return trees of the same structure as one, their leaves stacked."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)
