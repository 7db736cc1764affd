"""Bodies side by side, each in its episode, and what policies earn with them."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import gymnasium
import numpy as np
from jaxtyping import Array, Bool, Float

from neuroanimator.control.planning.environments import mujoco_state
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.gym.state_policy import StatePolicy
from neuroanimator.gym.state_rows import Stepper


class Moved(NamedTuple):
    """Result of a step, a row each."""

    following: Float[np.ndarray, "N S"]
    is_fallen: Bool[np.ndarray, " N"]
    """Whether the rules ended the episode, or the physics diverged."""
    is_last: Bool[np.ndarray, " N"]
    """Whether it is over."""


class Bodies:
    """N bodies that a stepper moves, each in its episode."""

    def __init__(
        self,
        stepper: Stepper,
        rules: EpisodeRules,
        emulator: Emulator,
        rng: np.random.Generator,
        count: int,
    ):
        """Begin an episode of each; `emulator` names states and bounds. ArgumentError for rules that draw no starts."""
        if rules.draw_start is None:
            raise ArgumentError("rules: wanted some that draw starts, as draw_start.")
        self.stepper = stepper
        self.rules = rules
        self.draw_start = rules.draw_start
        self.bounds = emulator.bounds
        self.states = np.zeros((count, emulator.state.size))
        self.ages = np.zeros(count, int)
        self.is_new = np.ones(count, bool)
        self.begin(rng, self.is_new)

    def begin(self, rng: np.random.Generator, rows: Bool[np.ndarray, " N"]) -> None:
        """Begin an episode in each of `rows`."""
        for row in np.flatnonzero(rows):
            self.states[row] = self.draw_start(rng)
        self.ages[rows] = 0
        self.is_new = rows

    def step(self, controls: Float[np.ndarray, "N C"]) -> Moved:
        """Go a step on."""
        leap = self.stepper(self.states, self.bounds.clip(controls), self.is_new)
        self.ages += 1
        self.states = np.array(leap.states, float)
        is_fallen = np.asarray(self.rules.is_over(self.states)) | leap.is_lost
        is_last = is_fallen | (self.ages >= (self.rules.steps or np.inf))
        return Moved(self.states.copy(), is_fallen, is_last)


def returns_of(
    policy: StatePolicy, stepper: Stepper, rules: EpisodeRules, episodes: int, seed: int
) -> Float[np.ndarray, " B"]:
    """Return the returns of whole episodes without noise, of bodies that `stepper` moves."""
    rng = np.random.default_rng([seed, episodes])
    bodies = Bodies(stepper, rules, policy.emulator, rng, episodes)
    total = np.zeros(episodes)
    goes_on = np.ones(episodes, bool)
    while goes_on.any():
        states = bodies.states.copy()
        controls = np.asarray(_controls(policy, as_jax(states)), float)
        moved = bodies.step(controls)
        rewards = np.asarray(rules.reward(states, controls, moved.following, policy.dt))
        total += np.where(goes_on, rewards, 0)
        goes_on &= ~moved.is_last
        bodies.begin(rng, moved.is_last)
    return total


def environment_returns(
    policy: StatePolicy, env_id: str, episodes: int, seed: int
) -> Float[np.ndarray, " B"]:
    """Return the returns of whole episodes in Gymnasium's environment `env_id` itself, without noise."""
    environment: Any = gymnasium.make(env_id)
    returns = []
    for episode in range(episodes):
        observation, _ = environment.reset(seed=seed + episode)
        total = 0.0
        is_over = False
        while not is_over:
            state = mujoco_state(environment, observation)
            action = np.asarray(_controls(policy, as_jax(state[None])))[0]
            observation, reward, is_terminated, is_truncated, _ = environment.step(action)
            total += float(reward)
            is_over = is_terminated or is_truncated
        returns.append(total)
    environment.close()
    return np.array(returns)


@eqx.filter_jit
def _controls(policy: StatePolicy, states: Float[Array, "B S"]) -> Float[Array, "B C"]:
    return policy.control_of(states)
