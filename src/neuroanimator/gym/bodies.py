"""Bodies side by side, each in its episode, and the returns of policies."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import gymnasium
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.models import mjcf_of
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.gym.state_rows import NOISE, StateRows, Stepper
from neuroanimator.learn.planning.environments import check_actions, mujoco_state


class Moved(NamedTuple):
    """Result of a step, a row each."""

    following: Float[np.ndarray, "N S"]
    rewards: Float[np.ndarray, " N"]
    is_fallen: Bool[np.ndarray, " N"]
    """Whether the rules ended the episode, or the physics diverged."""
    is_last: Bool[np.ndarray, " N"]
    """Whether the episode is over."""


class Bodies:
    """N bodies that a stepper moves, each in an episode of rules that draw starts."""

    def __init__(
        self,
        stepper: Stepper,
        rules: EpisodeRules,
        emulator: Emulator,
        rng: np.random.Generator,
        count: int,
    ):
        """Begin an episode of each; `emulator` gives states and bounds. ArgumentError for rules that draw no starts."""
        if rules.draw_start is None:
            raise ArgumentError("rules: wanted rules with draw_start, which draws starts.")
        self.rows = StateRows(emulator, stepper, rules, None, NOISE)
        self.is_cut = rules.is_cut
        self.disturb = rules.disturb
        self.ages = np.zeros(count, np.int32)
        self._restart(rng, np.ones(count, bool))

    @property
    def states(self) -> Float[np.ndarray, "N S"]:
        """Their current states."""
        return self.rows.states

    def begin(self, rng: np.random.Generator, rows: Bool[np.ndarray, " N"]) -> None:
        """Begin an episode in each of `rows`; apply the task's disturbances, if any, to all bodies."""
        if self.disturb is not None:
            self.rows.begin(self.disturb(rng, self.states), np.ones(len(rows), bool))
        if rows.any():
            self._restart(rng, rows)

    def _restart(self, rng: np.random.Generator, rows: Bool[np.ndarray, " N"]) -> None:
        self.rows.restart([rng] * int(rows.sum()), rows)
        self.ages[rows] = 0

    def resume(self, states: Float[np.ndarray, "N S"], ages: Int[np.ndarray, " N"]) -> None:
        """Resume with bodies in these states, `ages` steps after the starts of their episodes."""
        self.rows.begin(states, np.ones(len(states), bool))
        self.ages = ages.copy()

    def step(self, controls: Float[np.ndarray, "N C"]) -> Moved:
        """Take a step."""
        outcome = self.rows.step(self.rows.emulator.bounds.clip(controls))
        self.ages += 1
        is_last = outcome.is_over | (self.ages >= self.rows.steps) | self.is_cut(self.states)
        return Moved(self.states, outcome.rewards, outcome.is_over, is_last)


class WholeEpisodes(NamedTuple):
    """Whole episodes, a row each."""

    returns: Float[np.ndarray, " B"]
    is_fallen: Bool[np.ndarray, " B"]
    """Whether the rules ended it, instead of its length."""

    @property
    def finished(self) -> int:
        """Number of episodes that lasted their whole length."""
        return int((~self.is_fallen).sum())


def returns_of(
    policy: StatePolicy, stepper: Stepper, rules: EpisodeRules, episodes: int, seed: int
) -> Float[np.ndarray, " B"]:
    """Return the returns of whole episodes without noise, of bodies that `stepper` moves."""
    return episodes_of(policy, stepper, rules, episodes, seed).returns


def episodes_of(
    policy: StatePolicy, stepper: Stepper, rules: EpisodeRules, episodes: int, seed: int
) -> WholeEpisodes:
    """Return the outcomes of whole episodes without noise, of bodies that `stepper` moves."""
    rng = np.random.default_rng([seed, episodes])
    bodies = Bodies(stepper, rules, policy.emulator, rng, episodes)
    total = np.zeros(episodes)
    is_fallen = np.zeros(episodes, bool)
    goes_on = np.ones(episodes, bool)
    while goes_on.any():
        controls = np.asarray(_controls(policy, as_jax(bodies.states)), float)
        moved = bodies.step(controls)
        total += np.where(goes_on, moved.rewards, 0)
        is_fallen |= goes_on & moved.is_fallen
        goes_on &= ~moved.is_last
        bodies.begin(rng, moved.is_last)
    return WholeEpisodes(total, is_fallen)


def motion_of(
    policy: StatePolicy, stepper: Stepper, rules: EpisodeRules, steps: int, seed: int
) -> Float[np.ndarray, "K S"]:
    """Return the states of an episode without noise, at most `steps` super steps: it ends by the rules."""
    bodies = Bodies(stepper, rules, policy.emulator, np.random.default_rng(seed), 1)
    states = [bodies.states[0]]
    for _ in range(steps):
        moved = bodies.step(np.asarray(_controls(policy, as_jax(bodies.states)), float))
        states.append(moved.following[0])
        if moved.is_last[0]:
            break
    return np.array(states)


def environment_returns(
    policy: StatePolicy, env_id: str, episodes: int, seed: int
) -> Float[np.ndarray, " B"]:
    """Return the returns of whole episodes in Gymnasium's environment `env_id` itself, without noise.

    Its body has the parameters of the policy's state of rest, if that is of a family. Raises ArgumentError for an id that
    is not one of its MuJoCo environments, and for another body.
    """
    # Refuses other ids: a file's id may name a module, which `make` would import.
    mjcf_of(env_id)
    environment: Any = gymnasium.make(env_id)
    check_actions(policy.emulator, environment)
    parameters = policy.emulator.rest[list(policy.emulator.parameter_entries)]
    returns = []
    for episode in range(episodes):
        observation, _ = environment.reset(seed=seed + episode)
        total = 0.0
        is_over = False
        while not is_over:
            read = np.append(mujoco_state(environment, observation), parameters)
            state = policy.emulator.state.check(read, env_id)
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
