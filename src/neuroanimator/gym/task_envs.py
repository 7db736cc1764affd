"""The tasks of `control.tasks` as Gymnasium environments: a goal, a reward on the way, an end. Needs `[gym]`."""

from __future__ import annotations

from typing import Any, final

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Array
from numpy.typing import ArrayLike

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.film.live import Camera, checked_render_mode
from neuroanimator.gym.episodes import MAX_DISTANCE, Sight, observe, start_episodes, step_episodes
from neuroanimator.systems import load_system
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.tasks.rigid import RIGID_TASKS
from neuroanimator.tasks.swimmers import ANIMAL_TASKS, body_length
from neuroanimator.tasks.task import Task, Trial
from neuroanimator.zoo import find_emulator

TASKS = {task.name: task for task in (*RIGID_TASKS, *ANIMAL_TASKS)}

TRIALS = 100
"""Starts and goals an episode is drawn from: the same ones `benchmarks/control.py` solves."""
RIGID_SIZE = 10.0
"""[m] Distances to the goal are counted in this by what is not deformable: about as far as truck and lander go."""
BONUS = 1.0
"""Added to the reward of the step that succeeds, and taken from the one that fails."""


@final
class TaskVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` trials of a task at once; row i is a `TaskEnv` reset with seed + i.

    A row that has ended starts anew in the next step, whose action it ignores and whose reward is zero.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, task: str, num_envs: int = 1, render_mode: str | None = None):
        """Make it from the name of a task, such as `fish-reach`."""
        if task not in TASKS:
            raise ArgumentError(f"No task called '{task}'. Tasks: {', '.join(TASKS)}.")
        if num_envs < 1:
            raise ArgumentError(f"num_envs: wanted one or more, came {num_envs}.")
        self.task: Task = TASKS[task]
        self.num_envs = num_envs
        self.render_mode = checked_render_mode(render_mode)
        self.system = load_system(self.task.system)
        self.emulator = Emulator.load(find_emulator(f"{self.task.system}-{self.task.substeps}"))
        self.metadata = {**self.metadata, "render_fps": round(1 / self.emulator.dt)}
        self.steps = round(self.task.seconds / self.emulator.dt)
        self._scale = (
            body_length(self.system) if isinstance(self.system, DeformableSystem) else RIGID_SIZE
        )
        self._drawn: dict[int, Trial] = {}
        self._random = [np_random()[0] for _ in range(num_envs)]
        self._camera = Camera(self.emulator.spec)
        self._begin([0] * num_envs)
        bounds = self.emulator.bounds
        low, high = np.array(bounds.low, np.float32), np.array(bounds.high, np.float32)
        self.single_action_space = Box(low, high, dtype=np.float32)
        self.single_observation_space = Box(
            -MAX_DISTANCE, MAX_DISTANCE, (self._observed().shape[1],), np.float32
        )
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return (observations (B, O), info) of random trials, or of those numbered in `options["trial"]`."""
        if seed is not None:
            self._random = [np_random(seed + row)[0] for row in range(self.num_envs)]
        unknown = set(options or {}) - {"trial"}
        if unknown:
            raise ArgumentError(f"No reset option called '{unknown.pop()}'. Options: trial.")
        drawn = [draw_number(random) for random in self._random]
        self._begin(
            drawn
            if not options
            else np.broadcast_to(_numbers(options["trial"]), self.num_envs).tolist()
        )
        return self._observed(), {
            "trial": np.array(self._numbers),
            "_trial": np.ones(self.num_envs, bool),
        }

    def step(
        self, actions: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Return (observations (B, O), rewards, terminated, truncated, info), each (B,), after `actions` (B, C)."""
        is_new = self._has_ended
        episodes, rewards, is_covered, is_far = step_episodes(
            self.emulator,
            self._objectives,
            self._episodes,
            jnp.asarray(self._steps),
            self._controls(actions),
        )
        self._steps = self._steps + 1
        self._episodes = episodes
        states = np.asarray(episodes.states, float)
        reached = np.zeros(self.num_envs, bool)
        failed = np.zeros(self.num_envs, bool)
        for row in np.flatnonzero(~is_new):
            path = states[row, : self._steps[row] + 1]
            reached[row] = np.isfinite(path).all() and self._trials[row].is_success(path)
            failed[row] = bool(is_far[row]) or (
                not reached[row] and self._trials[row].has_failed(path)
            )
        rewards = np.where(
            is_new, 0.0, np.nan_to_num(np.asarray(rewards)) + BONUS * reached - BONUS * failed
        )
        self._restart(np.flatnonzero(is_new))
        terminated = reached | failed
        truncated = (self._steps >= self.steps) & ~terminated
        self._has_ended = terminated | truncated
        told = {
            "covered": np.asarray(is_covered) & ~is_new,
            "success": reached,
            "trial": np.array(self._numbers),
        }
        masks = {f"_{name}": ~is_new for name in told}
        return self._observed(), rewards, terminated, truncated, {**told, **masks}

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture (H, W, 3) of each row if `render_mode` is `rgb_array`; ResourceError without graphics."""
        if self.render_mode is None:
            return None
        rows = range(self.num_envs)
        return tuple(
            self._camera.picture(np.asarray(self._episodes.states[row, self._steps[row]]))
            for row in rows
        )

    def close_extras(self, **_: Any) -> None:
        """End the drawing process."""
        self._camera.close()

    def _begin(self, numbers: list[int]) -> None:
        """Begin the trials of these numbers, one a row."""
        self._numbers = list(numbers)
        self._trials = [self._draw(number) for number in numbers]
        self._steps = np.zeros(self.num_envs, int)
        self._has_ended = np.zeros(self.num_envs, bool)
        self._objectives = _stacked([trial.objective for trial in self._trials])
        self._sights = _stacked([Sight.of(trial.aim) for trial in self._trials])
        starts = np.stack([trial.start for trial in self._trials])
        self._episodes = start_episodes(
            self.emulator, self._objectives, self._encoded(starts), _float(starts), self.steps
        )

    def _restart(self, rows: np.ndarray) -> None:
        """Begin a new trial in each of `rows`, and let the others be."""
        if not len(rows):
            return
        steps, episodes, objectives, sights = (
            self._steps.copy(),
            self._episodes,
            self._objectives,
            self._sights,
        )
        numbers = [
            draw_number(self._random[row]) if row in rows else self._numbers[row]
            for row in range(self.num_envs)
        ]
        self._begin(numbers)
        keeps = jnp.asarray(~np.isin(np.arange(self.num_envs), rows))

        def pick(old, new):
            return jnp.where(keeps.reshape(-1, *(1,) * (new.ndim - 1)), old, new)

        self._episodes = jax.tree.map(pick, episodes, self._episodes)
        self._objectives = jax.tree.map(pick, objectives, self._objectives)
        self._sights = jax.tree.map(pick, sights, self._sights)
        self._steps = np.where(keeps, steps, 0)

    def _draw(self, number: int) -> Trial:
        """Return the trial of that number: always the same one, and that of the benchmark."""
        if number not in self._drawn:
            rng = np.random.default_rng([number, 5])
            self._drawn[number] = self.task.draw(self.system, rng, self.steps, self.emulator.dt)
        return self._drawn[number]

    def _encoded(self, states: np.ndarray) -> Array:
        return _float(self.emulator.encode(np.asarray(states, float)))

    def _observed(self) -> np.ndarray:
        left = jnp.asarray(1 - self._steps / self.steps, jnp.float32)
        sees_world = self._trials[0].aim.is_in_a_fixed_world
        latent = self._episodes.latent
        return np.array(
            observe(self.emulator, latent, self._sights, left, self._scale, sees_world), np.float32
        )

    def _controls(self, actions: ArrayLike) -> Array:
        """Return `actions` (B, C), brought within the bounds as a motor would."""
        controls = self.emulator.control.check(actions, "action")
        if controls.shape != self.action_space.shape:
            raise ArgumentError(
                f"action: wanted shape {self.action_space.shape}, came {controls.shape}."
            )
        return _float(self.emulator.bounds.clip(controls))


@final
class TaskEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One trial after another of a task, on its emulator; a step is a super step, actions are clipped to the bounds.

    An observation (O,), kept within ±`MAX_DISTANCE`, holds in this order: what the emulator's network sees of the body
    (sines and cosines of angles; velocities, shape and contractions in standard deviations of training), then for
    systems that have a place: the goal's place seen from the body, along its own axes, in body lengths or 10 m; the
    wished direction along the same axes; up along the same axes; among obstacles, place (in 10 m) and direction in the
    world; last the share of time that is left.

    The reward is by how much the step lowered J, over J at the start: J is the task's own objective, taken as if
    everything stayed as it is until the end. So rewards sum to 1 - J/J(start), and the best return is the best
    controller. The step that succeeds gets `BONUS` more, the one that fails so much less.

    It is terminated by success, by failure (a crash, an obstacle touched, far outside training), and truncated when
    time is up. `info["success"]` says which, `info["covered"]` whether training covered the step.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(self, task: str, render_mode: str | None = None):
        """Make it from the name of a task, such as `fish-reach`."""
        self._envs = TaskVectorEnv(task, 1, render_mode)
        self.render_mode = self._envs.render_mode
        self.metadata = {**self.metadata, "render_fps": self._envs.metadata["render_fps"]}
        self.observation_space = self._envs.single_observation_space
        self.action_space = self._envs.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return (observation (O,), info) of a random trial, or of the one numbered `options["trial"]`."""
        super().reset(seed=seed)
        number = draw_number(self.np_random)
        seen, info = self._envs.reset(options={"trial": number, **(options or {})})
        return seen[0], {"trial": int(info["trial"][0])}

    def step(self, action: ArrayLike) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Return (observation (O,), reward, terminated, truncated, info) after `action` (C,) held for a super step."""
        seen, rewards, terminated, truncated, info = self._envs.step(np.asarray(action)[None])
        told = {"covered": bool(info["covered"][0]), "success": bool(info["success"][0])}
        return seen[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), told

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a picture (H, W, 3) in uint8 if `render_mode` is `rgb_array`; ResourceError if none can be drawn."""
        pictures = self._envs.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """End the drawing process."""
        self._envs.close()


def draw_number(random: np.random.Generator) -> int:
    """Return the number of a random trial."""
    return int(random.integers(TRIALS))


def _numbers(wanted: ArrayLike) -> np.ndarray:
    numbers = np.asarray(wanted)
    if (
        numbers.ndim > 1
        or numbers.dtype.kind not in "iu"
        or not ((numbers >= 0) & (numbers < TRIALS)).all()
    ):
        raise ArgumentError(f"trial: wanted numbers from 0 to {TRIALS - 1}, came {wanted}.")
    return numbers


def _float(numbers: ArrayLike) -> Array:
    return jnp.asarray(numbers, jnp.float32)


def _stacked(rows: list[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)
