"""A vector environment over episodes that an emulator, the physics or a task steps."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jax._src import xla_bridge
from jaxtyping import Bool, Float, Int, Shaped, UInt8
from numpy.typing import ArrayLike

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.film.live import LiveCamera, checked_render_mode

MASK = "reset_mask"
"""Gymnasium's name of the option of `reset` that says which rows begin anew."""

_forked: list[int] = []
"""This process, if it is such a one."""


def _note() -> None:
    if xla_bridge.backends_are_initialized():
        _forked[:] = [os.getpid()]


def refuse_forked() -> None:
    """Raise ResourceError in a process that was forked after JAX had started."""
    if _forked:
        raise ResourceError(
            "This process was forked from one in which JAX runs, and would wait for ever. Start workers anew: "
            "make_vec(..., 'async', vector_kwargs={'context': 'spawn'}). Or leave vectorization_mode out: all "
            "environments are then stepped at once in one process, which is faster."
        )


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note)


class StepResults(NamedTuple):
    """Result of a super step, a row each."""

    rewards: Float[np.ndarray, " B"]
    is_over: Bool[np.ndarray, " B"]
    """Whether the episode ends for another reason than its length."""
    info: dict[str, Shaped[np.ndarray, " B"]]
    is_cut: Bool[np.ndarray, " B"] | bool = False
    """Whether it ends by its length."""

    @property
    def is_last(self) -> Bool[np.ndarray, " B"]:
        """Whether it ends."""
        return self.is_over | self.is_cut


class EpisodeRows(ABC):
    """Episodes side by side, a row each: their starts, super steps and observations."""

    emulator: Emulator
    """Emulator that defines the state, the controls and the super step."""
    steps: int
    """Number of super steps after which an episode is truncated."""
    option: str
    """Name of the option of `reset` with the start of episodes."""
    first: ArrayLike
    """Start of an environment not yet reset."""
    max_observation: float
    """Maximum magnitude of observations."""
    states: Float[np.ndarray, "B S"]
    """Current states, which pictures show."""
    ages: Int[np.ndarray, " *B"] = np.zeros((), np.int32)
    """Number of super steps since each episode began."""

    @abstractmethod
    def draw(self, random: Sequence[np.random.Generator]) -> Shaped[np.ndarray, "R ..."]:
        """Return a random start from each of `random`."""

    @abstractmethod
    def check(self, start: ArrayLike) -> Shaped[np.ndarray, "*BX"]:
        """Return one start or many as an array; ArgumentError for invalid ones."""

    @abstractmethod
    def place(self, starts: Shaped[np.ndarray, "B ..."], rows: Bool[np.ndarray, " B"]) -> None:
        """Put each of `rows` in its start, and leave the others."""

    @abstractmethod
    def advance(self, controls: Float[np.ndarray, "B C"]) -> StepResults:
        """Take the super step that `step` counts."""

    @abstractmethod
    def observe(self) -> Float[np.ndarray, "B O"]:
        """Return the observations, as a new array."""

    def begin(self, starts: Shaped[np.ndarray, "B ..."], rows: Bool[np.ndarray, " B"]) -> None:
        """Begin an episode in each of `rows`, and leave the others."""
        self.ages = np.where(rows, 0, self.ages)
        self.place(starts, rows)

    def step(self, controls: Float[np.ndarray, "B C"]) -> StepResults:
        """Take a super step."""
        outcome = self.advance(controls)
        self.ages = self.ages + 1
        return outcome._replace(is_cut=outcome.is_cut | (self.ages >= self.steps))

    def restart(self, random: Sequence[np.random.Generator], rows: Bool[np.ndarray, " B"]) -> None:
        """Begin an episode in each of `rows`, at a random start from each of `random`."""
        drawn = self.draw(random)
        starts = np.zeros((len(rows), *drawn.shape[1:]), drawn.dtype)
        starts[rows] = drawn
        self.begin(starts, rows)

    def facts(self) -> dict[str, Shaped[np.ndarray, " B"]]:
        """Return the part of `info` that is known from the beginning of an episode."""
        return {}


class RowsVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` episodes in one compiled call; a step is a super step, actions are clipped to the bounds.

    Observations, rewards, ends and `info` are those of Gymnasium's `SyncVectorEnv` of the single environments. A row that
    has ended restarts in the next step, which ignores its action and has reward zero; or in the same step with
    `AutoresetMode.SAME_STEP`: `info["final_obs"]` and `info["final_info"]` are then those of the end. With
    `AutoresetMode.DISABLED` it waits for `reset(options={"reset_mask": rows})`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __new__(cls, *_: Any, **__: Any):
        """Refuse at once what would wait for ever."""
        refuse_forked()
        return super().__new__(cls)

    def __init__(
        self,
        rows: EpisodeRows,
        num_envs: int,
        render_mode: str | None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    ):
        """Raise ArgumentError without rows, and for an unknown render mode."""
        if num_envs < 1:
            raise ArgumentError(f"num_envs: wanted one or more, got {num_envs}.")
        emulator = rows.emulator
        self.rows = rows
        self.emulator = emulator
        self.num_envs = num_envs
        self.render_mode = checked_render_mode(render_mode)
        if self.render_mode is not None and not emulator.skeleton.bones:
            raise ArgumentError(
                f"render_mode: {emulator.system} has no bodies to draw, only numbers. Leave it out; 'animate' draws gauges."
            )
        self.metadata = self.metadata | {
            "render_fps": round(1 / emulator.dt),
            "autoreset_mode": AutoresetMode(autoreset_mode),
        }
        low = np.array(emulator.bounds.low, np.float32)
        high = np.array(emulator.bounds.high, np.float32)
        self.single_action_space = Box(low, high, dtype=np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._camera = LiveCamera(emulator.spec)
        self.random = [np_random()[0] for _ in range(num_envs)]
        self._has_ended = np.zeros(num_envs, bool)
        self._everywhere = np.ones(num_envs, bool)
        self._begin(np.asarray(rows.first), self._everywhere)
        limit = rows.max_observation
        shape = rows.observe().shape[1:]
        self.single_observation_space = Box(-limit, limit, shape, np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Float[np.ndarray, "B O"], dict[str, Any]]:
        """Return (observations, info) of random starts, or of the start or starts in `options`.

        Row i draws from `seed` + i, or from the seed i of many; without a seed, rows continue their random streams. The
        options are `state`, (S,) or (B, S), or the number of a task's `trial`; and `reset_mask` (B,), which rows begin
        anew: all if it is missing.
        """
        refuse_forked()
        option = self.rows.option
        chosen = options or {}
        unknown = set(chosen) - {option, MASK}
        if unknown:
            raise ArgumentError(
                f"No reset option called '{unknown.pop()}'. Options: {option}, {MASK}."
            )
        rows = self._checked_mask(chosen.get(MASK, self._everywhere))
        seeds = self._seeds(seed)
        starts = self.rows.check(chosen[option]) if option in chosen else None
        for row, own in enumerate(seeds):
            if rows[row] and own is not None:
                self.random[row] = np_random(own)[0]
        if starts is None:
            self._restart(rows)
        else:
            self._begin(starts, rows)
        return self.rows.observe(), _masked(self.rows.facts(), rows)

    def step(
        self, actions: ArrayLike
    ) -> tuple[
        Float[np.ndarray, "B O"],
        Float[np.ndarray, " B"],
        Bool[np.ndarray, " B"],
        Bool[np.ndarray, " B"],
        dict[str, Any],
    ]:
        """Return (observations, rewards, terminated, truncated, info) after holding `actions` (B, C) for a super step."""
        refuse_forked()
        mode = self.metadata["autoreset_mode"]
        if mode is AutoresetMode.DISABLED and self._has_ended.any():
            raise ArgumentError(
                f"Rows have ended: {np.flatnonzero(self._has_ended).tolist()}. "
                'Reset them before the next step: reset(options={"reset_mask": terminated | truncated}).'
            )
        controls = self._checked_actions(actions).astype(np.float32)
        is_old = ~self._has_ended
        outcome = self.rows.step(controls)
        self._restart(self._has_ended)
        terminated = outcome.is_over & is_old
        truncated = outcome.is_cut & is_old & ~terminated
        self._has_ended = terminated | truncated
        info: dict[str, Any] = {}
        goes_on = is_old
        if mode is AutoresetMode.SAME_STEP and self._has_ended.any():
            goes_on = ~self._has_ended
            info = self._final_info(outcome.info | self.rows.facts())
            self._restart(self._has_ended)
        info |= _masked(outcome.info, goes_on) | _masked(self.rows.facts(), self._everywhere)
        rewards = np.where(is_old, outcome.rewards, 0.0)
        return self.rows.observe(), rewards, terminated, truncated, info

    def render(self) -> tuple[UInt8[np.ndarray, "H W 3"], ...] | None:
        """Return a picture of each row if `render_mode` is `rgb_array`; ResourceError without graphics."""
        if self.render_mode is None:
            return None
        return tuple(self._camera.picture(state) for state in self.rows.states)

    def close_extras(self, **_: Any) -> None:
        """Free the memory of pictures."""
        self._camera.close()

    def _begin(self, starts: Shaped[np.ndarray, "*BX"], rows: Bool[np.ndarray, " B"]) -> None:
        """Begin an episode in each of `rows` at one start, or each at its own."""
        one = np.shape(self.rows.first)
        wanted = (self.num_envs, *one)
        if starts.shape not in (one, wanted):
            raise ArgumentError(
                f"{self.rows.option}: wanted shape {one} or {wanted}, got {starts.shape}."
            )
        self.rows.begin(np.broadcast_to(starts, wanted), rows)
        self._has_ended = self._has_ended & ~rows

    def _restart(self, rows: Bool[np.ndarray, " B"]) -> None:
        """Begin an episode at a random start in each of `rows`."""
        if not rows.any():
            return
        self.rows.restart([self.random[row] for row in np.flatnonzero(rows)], rows)
        self._has_ended = self._has_ended & ~rows

    def _final_info(self, info: dict[str, Shaped[np.ndarray, " B"]]) -> dict[str, Any]:
        """Return the last observations and `info` of rows that have ended, as Gymnasium's vector environments do."""
        last = np.full(self.num_envs, None, object)
        observations = self.rows.observe()
        for row in np.flatnonzero(self._has_ended):
            last[row] = observations[row]
        return {
            "final_obs": last,
            "_final_obs": self._has_ended.copy(),
            "final_info": _masked(info, self._has_ended),
            "_final_info": self._has_ended.copy(),
        }

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        """Return the seed of each row, None where its random stream continues."""
        if seed is None:
            return [None] * self.num_envs
        if not isinstance(seed, Sequence):
            return range(seed, seed + self.num_envs)
        if len(seed) != self.num_envs:
            raise ArgumentError(
                f"seed: wanted a number, or one for each of {self.num_envs} rows, got {len(seed)}."
            )
        return seed

    def _checked_mask(self, mask: ArrayLike) -> Bool[np.ndarray, " B"]:
        """Return which rows to reset; ArgumentError for anything else."""
        rows = np.asarray(mask)
        if rows.dtype != bool or rows.shape != (self.num_envs,) or not rows.any():
            raise ArgumentError(
                f"{MASK}: wanted {self.num_envs} of True and False, one of them True, got {mask}."
            )
        return rows

    def _checked_actions(self, actions: ArrayLike) -> Float[np.ndarray, "B C"]:
        """Return `actions` (B, C), clipped to the bounds as by a motor."""
        controls = self.emulator.control.check(actions, "action")
        if controls.shape != self.action_space.shape:
            raise ArgumentError(
                f"action: wanted shape {self.action_space.shape}, got {controls.shape}."
            )
        return self.emulator.bounds.clip(controls)


def _masked(info: dict[str, Any], rows: Bool[np.ndarray, " B"]) -> dict[str, Any]:
    """Return `info` of `rows`, zero elsewhere, with Gymnasium's masks of the rows that have it; nothing for no rows."""
    masked = {}
    if not rows.any():
        return masked
    for name, values in info.items():
        masked[name] = np.where(rows, values, np.zeros_like(values))
        masked[f"_{name}"] = rows.copy()
    return masked
