"""Rows of states as environments: what emulated and simulated ones have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from jaxtyping import Bool, Float, Shaped
from numpy.typing import ArrayLike

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.gym.vector_env import EmulatedVectorEnv, check_reset_options
from neuroanimator.state.slowness import slowness

SECONDS = 10.0
"""Length of an episode if nothing else is said [s]; of a slow system longer."""

NOISE = 0.1
"""How far starts lie from rest, in standard deviations of the change in one super step: visible, but hardly."""


class Leap(NamedTuple):
    """What a super step does to each row."""

    states: Float[np.ndarray, "B S"]
    is_lost: Bool[np.ndarray, " B"]
    """Whether the motion is no longer to be believed, so that the episode ends."""
    penalties: Float[np.ndarray, " B"]
    """What the step loses besides what the rules say."""
    info: dict[str, Shaped[np.ndarray, " B"]]


class StateVectorEnv(EmulatedVectorEnv):
    """`num_envs` episodes by the same rules; what steps their states is up to who derives from it."""

    def __init__(
        self,
        emulator: Emulator,
        num_envs: int,
        rules: EpisodeRules,
        seconds: float | None,
        noise: float,
        render_mode: str | None,
        autoreset_mode: AutoresetMode,
    ):
        """`emulator` names the state and its super step; the rules' length of episodes holds unless `seconds` are given."""
        super().__init__(emulator, num_envs, render_mode)
        if seconds is None and rules.steps is not None:
            seconds = rules.steps * emulator.dt
        if seconds is None:
            seconds = SECONDS * slowness(emulator.dt)
        if not emulator.dt <= seconds < np.inf:
            raise ArgumentError(
                f"seconds: wanted at least one super step of {emulator.dt:g} s, came {seconds:g}."
            )
        if autoreset_mode is AutoresetMode.DISABLED:
            raise ArgumentError("autoreset_mode: wanted NEXT_STEP or SAME_STEP, came DISABLED.")
        self.metadata = self.metadata | {"autoreset_mode": autoreset_mode}
        self._restarts_at_once = autoreset_mode is AutoresetMode.SAME_STEP
        self.rules = rules
        self.noise = noise
        self.steps = round(seconds / emulator.dt)
        shown = rules.observe(emulator.rest[None])
        self.set_observation_space(Box(-np.inf, np.inf, shown.shape[1:], np.float32))
        self._begin(emulator.rest)

    @abstractmethod
    def begin_rows(
        self, states: Float[np.ndarray, "B S"], rows: Bool[np.ndarray, " B"]
    ) -> Float[np.ndarray, "B S"]:
        """Let those `rows` go on from their `states`; return the states of all as they are kept."""

    @abstractmethod
    def leap(self, states: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B C"]) -> Leap:
        """Return what a super step from `states` under `controls` does."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, "B O"], dict[str, Any]]:
        """Return (observations, {}) of random starts, or of those `options["state"]` (S,) or (B, S) says."""
        self._seed_rows(seed)
        check_reset_options(options, "state")
        if options:
            self._begin(self.emulator.state.check(options["state"], "state"))
        else:
            self._begin(self.draw_starts(self._random))
        return self._observe(), {}

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
        controls = self._checked_actions(actions).astype(np.float32)
        is_new = self._has_ended
        made = self.leap(self._states, controls)
        with np.errstate(all="ignore"):  # a row that diverged earns no number
            rewards = self.rules.reward(self._states, controls, made.states, self.emulator.dt)
            is_over = self.rules.is_over(made.states) | made.is_lost
        rewards = np.nan_to_num(rewards - made.penalties, posinf=0.0, neginf=0.0)
        self._states = made.states
        self._steps = self._steps + 1
        self._has_ended = np.zeros(self.num_envs, bool)
        self._restart(is_new)
        terminated = is_over & ~is_new
        truncated = self._steps >= self.steps
        self._has_ended = terminated | truncated
        info = {name: values.copy() for name, values in made.info.items()}
        if "covered" in info:
            info["covered"] &= ~is_new
        info |= {f"_{name}": ~is_new for name in list(info)}
        if self._restarts_at_once and self._has_ended.any():
            info |= self._final_info()
            self._restart(self._has_ended)
        return self._observe(), np.where(is_new, 0.0, rewards), terminated, truncated, info

    def draw_starts(self, random: Sequence[np.random.Generator]) -> Float[np.ndarray, "B S"]:
        """Return a random start by each of `random`."""
        if self.rules.draw_start is None:
            return starts_near_rest(self.emulator, self.noise, random)
        starts = np.stack([self.rules.draw_start(rng) for rng in random])
        return self.emulator.state.check(starts, "rules.draw_start")

    def shown_states(self) -> Float[np.ndarray, "B S"]:
        return self._states

    def _final_info(self) -> dict[str, Any]:
        """Return the last observations of rows that have ended, as Gymnasium's vector environments say them."""
        last = np.full(self.num_envs, None, object)
        observations = self._observe()
        for row in np.flatnonzero(self._has_ended):
            last[row] = observations[row]
        return {"final_obs": last, "_final_obs": self._has_ended.copy()}

    def _observe(self) -> Float[np.ndarray, "B O"]:
        """Return what a policy is shown, as a new array."""
        return np.array(self.rules.observe(self._states), np.float32)

    def _restart(self, rows: Bool[np.ndarray, " B"]) -> None:
        """Begin new episodes in `rows`."""
        if not rows.any():
            return
        states = self._states.copy()
        states[rows] = self.draw_starts([self._random[row] for row in np.flatnonzero(rows)])
        self._states = self.begin_rows(states, rows)
        self._steps = np.where(rows, 0, self._steps)
        self._has_ended = self._has_ended & ~rows

    def _begin(self, states: Float[np.ndarray, "*B S"]) -> None:
        """Begin an episode in each row at `states` (S,) or (B, S)."""
        shape = (self.num_envs, self.emulator.state.size)
        if states.shape not in (shape, shape[1:]):
            raise ArgumentError(f"state: wanted shape {shape[1:]} or {shape}, came {states.shape}.")
        everywhere = np.ones(self.num_envs, bool)
        self._states = self.begin_rows(np.broadcast_to(states, shape).astype(float), everywhere)
        self._steps = np.zeros(self.num_envs, int)
        self._has_ended = ~everywhere


def start_near_rest(
    emulator: Emulator, noise: float, rng: np.random.Generator
) -> Float[np.ndarray, " S"]:
    """Return rest with noise along what a state can change by, so that quaternions stay of length one.

    `noise` is in standard deviations of the change in one super step. A deformable body is moved by what noise does
    to its latent state, which cannot show rest itself exactly.
    """
    return starts_near_rest(emulator, noise, [rng])[0]


def starts_near_rest(
    emulator: Emulator, noise: float, random: Sequence[np.random.Generator]
) -> Float[np.ndarray, "B S"]:
    """Return `start_near_rest` by each of `random`: at once, as thousands one after another take minutes."""
    # Noise is drawn around rest as it is, not as it would coast.
    frame = replace(emulator.frame, dt=0.0)
    rest = emulator.rest
    unit = np.asarray(emulator.normaliser.unit, float)
    still = np.zeros((1, len(unit)))
    drawn = [noise * unit * rng.normal(size=unit.shape) for rng in random]
    changes = np.concatenate([still, drawn])
    latent = np.tile(emulator.encode(rest), (len(changes), 1))
    states = emulator.decode(frame.apply(latent, changes))
    return rest + (states[1:] - states[0])
