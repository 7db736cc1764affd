"""Bodies side by side, each in its episode, and the returns of policies."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import gymnasium
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from neuroanimator.control.policies.state_policy import StatePolicy, controls_of
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.models import mjcf_of
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.gym.state_rows import NOISE, StateRows, Stepper
from neuroanimator.gym.vector_env import StepResults
from neuroanimator.learn.planning.environments import check_actions, mujoco_state


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
        self.disturb = rules.disturb
        self._everywhere = np.ones(count, bool)
        self.rows.restart([rng] * count, self._everywhere)

    @property
    def states(self) -> Float[np.ndarray, "N S"]:
        """Their current states."""
        return self.rows.states

    @property
    def ages(self) -> Int[np.ndarray, " N"]:
        """Numbers of steps since the starts of their episodes."""
        return self.rows.ages

    def begin(self, rng: np.random.Generator, rows: Bool[np.ndarray, " N"]) -> None:
        """Begin an episode in each of `rows`; apply the task's disturbances, if any, to all bodies."""
        if self.disturb is not None:
            self.rows.place(self.disturb(rng, self.states), self._everywhere)
        if rows.any():
            self.rows.restart([rng] * int(rows.sum()), rows)

    def resume(self, states: Float[np.ndarray, "N S"], ages: Int[np.ndarray, " N"]) -> None:
        """Resume with bodies in these states, `ages` steps after the starts of their episodes."""
        self.rows.place(states, self._everywhere)
        self.rows.ages = ages

    def step(self, controls: Float[np.ndarray, "N C"]) -> StepResults:
        """Take a step."""
        return self.rows.step(self.rows.emulator.bounds.clip(controls))


class Rollouts(NamedTuple):
    """T steps of N bodies."""

    states: Float[Array, "T N S"]
    noise: Float[Array, "T N C"]
    """Noise added to the outputs of the policy's network."""
    controls: Float[Array, "T N C"]
    following: Float[Array, "T N S"]
    is_fallen: Bool[Array, "T N"]
    """Whether the rules ended the episode: no reward follows."""
    is_last: Bool[Array, "T N"]
    """Whether the episode ended, by the rules or by its length."""


def roll_out(
    policy: StatePolicy,
    bodies: Bodies,
    noises: Iterable[Float[np.ndarray, "N C"]],
    rng: np.random.Generator,
) -> Rollouts:
    """Return a step of `bodies` for each of `noises`, which are drawn one by one; episodes that end begin anew."""
    steps = []
    for noise in noises:
        states = bodies.states.astype(np.float32)
        controls = np.asarray(controls_of(policy, as_jax(states), as_jax(noise)))
        outcome = bodies.step(controls)
        following = bodies.states.astype(np.float32)
        steps.append((states, noise, controls, following, outcome.is_over, outcome.is_last))
        bodies.begin(rng, outcome.is_last)
    return Rollouts(*(jnp.asarray(np.stack(part)) for part in zip(*steps, strict=True)))


class WholeEpisodes(NamedTuple):
    """Whole episodes, a row each."""

    returns: Float[np.ndarray, " B"]
    is_fallen: Bool[np.ndarray, " B"]
    """Whether the rules ended it, instead of its length."""

    @property
    def finished(self) -> int:
        """Number of episodes that lasted their whole length."""
        return int((~self.is_fallen).sum())


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
        controls = np.asarray(controls_of(policy, as_jax(bodies.states)), float)
        outcome = bodies.step(controls)
        total += np.where(goes_on, outcome.rewards, 0)
        is_fallen |= goes_on & outcome.is_over
        goes_on &= ~outcome.is_last
        bodies.begin(rng, outcome.is_last)
    return WholeEpisodes(total, is_fallen)


def motion_of(
    policy: StatePolicy, stepper: Stepper, rules: EpisodeRules, steps: int, seed: int
) -> Float[np.ndarray, "K S"]:
    """Return the states of an episode without noise, at most `steps` super steps: it ends by the rules."""
    bodies = Bodies(stepper, rules, policy.emulator, np.random.default_rng(seed), 1)
    states = [bodies.states[0]]
    for _ in range(steps):
        outcome = bodies.step(np.asarray(controls_of(policy, as_jax(bodies.states)), float))
        states.append(bodies.states[0])
        if outcome.is_last[0]:
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
            action = np.asarray(controls_of(policy, as_jax(state[None])))[0]
            observation, reward, is_terminated, is_truncated, _ = environment.step(action)
            total += float(reward)
            is_over = is_terminated or is_truncated
        returns.append(total)
    environment.close()
    return np.array(returns)
