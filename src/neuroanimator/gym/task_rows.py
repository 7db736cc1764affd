"""Episodes of a task: numbered trials, J so far, success and failure."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import ArrayLike

from neuroanimator.control.objective.objective import Objective, Trajectory
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.batched_step import (
    MAX_OBSERVATION,
    Aims,
    Observer,
    observe_rows,
    step_rows,
)
from neuroanimator.gym.vector_env import EpisodeRows, StepResults
from neuroanimator.learn.tasks.all_tasks import TASKS
from neuroanimator.learn.tasks.solver import Solver
from neuroanimator.state.arrays import AnyArray

TRIALS = 100
"""Number of starts and goals from which an episode is drawn: those that `benchmarks/control/control.py` solves."""

RIGID_SCALE = 10.0
"""Unit of distances to the goal for rigid bodies [m]: about as far as truck and lander go."""

BONUS = 1.0
"""Reward added on success, and subtracted on failure."""


class Episodes(NamedTuple):
    """Episodes in progress, a row each."""

    latent: Float[np.ndarray, "B I"]
    controls: Float[np.ndarray, "B T C"]
    """The controls held; future ones are zero."""
    states: Float[np.ndarray, "B T+1 S"]
    """The trajectories; future states repeat the last one."""
    cost: Float[np.ndarray, " B"]
    """J if everything stayed as it is."""
    first_cost: Float[np.ndarray, " B"]
    """J if everything had stayed as at the start."""


@final
class TaskRows(EpisodeRows):
    """Trials of a task on its emulator; the number of a trial is its start."""

    option = "trial"
    first = 0
    max_observation = MAX_OBSERVATION

    def __init__(self, task: str):
        if task not in TASKS:
            raise ArgumentError(f"No task called '{task}'. Tasks: {', '.join(TASKS)}.")
        self.solver = Solver.shipped(TASKS[task])
        self.emulator = self.solver.emulator
        self.steps = self.solver.steps
        self.trial = cache(self.solver.draw)
        self.scale = self.solver.system.body_length or RIGID_SCALE
        self.numbers: Int[np.ndarray, " *B"] = np.zeros((), int)
        self._observer = Observer(
            self.emulator, self.scale, self.trial(self.first).aim.is_in_a_fixed_world
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: trials are drawn again by their numbers."""
        return {name: part for name, part in vars(self).items() if name not in ("trial", "_trials")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.trial = cache(self.solver.draw)
        self._trials = [self.trial(int(number)) for number in self.numbers]

    def draw(self, random: Sequence[np.random.Generator]) -> Int[np.ndarray, " R"]:
        return np.array([rng.integers(TRIALS) for rng in random])

    def check(self, start: ArrayLike) -> Int[np.ndarray, " *B"]:
        numbers = np.asarray(start)
        is_whole = numbers.dtype.kind in "iu"
        if not is_whole or not ((numbers >= 0) & (numbers < TRIALS)).all():
            raise ArgumentError(f"trial: wanted numbers from 0 to {TRIALS - 1}, got {start}.")
        return numbers

    def place(self, starts: Int[np.ndarray, " B"], rows: Bool[np.ndarray, " B"]) -> None:
        self.numbers = np.where(rows, starts, self.numbers)
        self._trials = [self.trial(int(number)) for number in self.numbers]
        objectives = [trial.objective for trial in self._trials]
        self._objectives = jax.tree.map(lambda *leaves: jnp.stack(leaves), *objectives)
        self._aims = Aims.of([trial.aim for trial in self._trials])
        begun = self._begun()
        if rows.all():
            self.episodes = begun
        for part, new in zip(self.episodes, begun, strict=True):
            part[rows] = new[rows]
        self.states = self.episodes.states[np.arange(len(rows)), self.ages]

    def advance(self, controls: Float[np.ndarray, "B C"]) -> StepResults:
        """Take a super step; a row that has taken all its super steps keeps its motion."""
        before = self.episodes
        counts = self.ages
        made = step_rows(self.emulator, before.latent, controls)
        is_to_come = np.arange(self.solver.steps + 1) > counts[:, None]
        states = np.where(is_to_come[..., None], made.states[:, None], before.states)
        is_held = np.arange(self.solver.steps) == counts[:, None]
        held = np.where(is_held[..., None], controls[:, None], before.controls)
        cost = self._costs(held, states)
        with np.errstate(all="ignore"):  # a diverged row has no finite cost
            rewards = np.nan_to_num((before.cost - cost) / before.first_cost)
        self.episodes = Episodes(made.latent, held, states, cost, before.first_cost)
        self.states = made.states
        has_succeeded = np.zeros(len(counts), bool)
        has_failed = made.ends_far.copy()
        for row, trial in enumerate(self._trials):
            path = states[row, : counts[row] + 2].astype(float)
            has_succeeded[row] = np.isfinite(path).all() and trial.is_success(path)
            has_failed[row] |= trial.has_failed(path) and not has_succeeded[row]
        info = made.info | {"success": has_succeeded}
        earned = rewards + BONUS * has_succeeded - BONUS * has_failed
        return StepResults(earned, has_succeeded | has_failed, info)

    def observe(self) -> Float[np.ndarray, "B O"]:
        time_left = 1 - self.ages / self.solver.steps
        return observe_rows(self._observer, self.episodes.latent, self._aims, time_left)

    def facts(self) -> dict[str, Int[np.ndarray, " B"]]:
        return {"trial": self.numbers}

    def _begun(self) -> Episodes:
        """Return the episodes of all trials at their starts."""
        starts = np.stack([np.asarray(trial.start, float) for trial in self._trials])
        latent = np.asarray(self.emulator.encode(starts), np.float32)
        states = np.repeat(starts[:, None].astype(np.float32), self.solver.steps + 1, axis=1)
        controls = np.zeros(
            (len(starts), self.solver.steps, self.emulator.control.size), np.float32
        )
        cost = self._costs(controls, states)
        return Episodes(latent, controls, states, cost, cost)

    def _costs(
        self, controls: Float[np.ndarray, "B T C"], states: Float[np.ndarray, "B T+1 S"]
    ) -> Float[np.ndarray, " B"]:
        """Return J of each row by its own objective."""
        scale = np.asarray(self.emulator.bounds.magnitude, np.float32)
        return np.array(_costs(self._objectives, controls, states, scale, self.emulator.dt))


@eqx.filter_jit
def _costs(
    objectives: Objective,
    controls: Float[AnyArray, "B T C"],
    states: Float[AnyArray, "B T+1 S"],
    scale: Float[AnyArray, " C"],
    dt: float,
) -> Float[AnyArray, " B"]:
    def cost(objective: Objective, held: Array, path: Array) -> Array:
        return objective(Trajectory(path, held, scale, dt))

    return eqx.filter_vmap(cost)(objectives, controls, states)
