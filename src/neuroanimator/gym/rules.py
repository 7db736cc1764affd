"""Rules that make physics a task: observations, rewards, and where episodes begin and end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from neuroanimator.control.objective.objective import Objective, Trajectory
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.physics import tied_system
from neuroanimator.state.arrays import AnyArray
from neuroanimator.systems.system import closed_starts

RowReward = Callable[
    [Float[np.ndarray, "B S"], Float[np.ndarray, "B C"], Float[np.ndarray, "B S"], float],
    Float[np.ndarray, " B"],
]
"""(states, controls, states one step later, duration of that step [s]) → rewards of many rows at once, in NumPy."""

Observer = Callable[[Float[np.ndarray, "B S"]], Float[np.ndarray, "B O"]]
"""States → observations."""

Ending = Callable[[Float[np.ndarray, "B S"]], Bool[np.ndarray, " B"]]
"""States after a step → whether the task ends the episode."""

StartDraw = Callable[[np.random.Generator], Float[np.ndarray, " S"]]
"""Random generator → the initial state of an episode."""


Disturbance = Callable[[np.random.Generator, Float[np.ndarray, "B S"]], Float[np.ndarray, "B S"]]
"""(random generator, states between two steps) → the states as changed by the task."""


def whole_state(states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B S"]:
    """Return the states: the whole state is observed."""
    return states


def never(states: Float[np.ndarray, "B S"]) -> Bool[np.ndarray, " B"]:
    """Return False for every row."""
    return np.zeros(len(states), bool)


def unpaid(
    states: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B C"],
    following: Float[np.ndarray, "B S"],
    dt: float,
) -> Float[np.ndarray, " B"]:
    """Return zero rewards: they are computed elsewhere, or do not matter."""
    return np.zeros(len(states))


@dataclass(frozen=True)
class EpisodeRules:
    """A task as functions of many rows, the same for any physics that steps the states.

    A policy learnt in an emulator by the rules of an environment acts in that environment unchanged.
    """

    reward: RowReward
    observe: Observer = whole_state
    is_over: Ending = never
    draw_start: StartDraw | None = None
    """Draws the initial states; None for starts near rest, see `starts_near_rest`."""
    steps: int | None = None
    """Number of super steps after which an episode is truncated; None for the default length."""
    is_cut: Ending = never
    """Whether episodes are truncated before `steps`."""
    disturb: Disturbance | None = None
    """Changes to bodies between two steps, such as new commands; used while policies learn."""


def drawn_starts(
    rules: EpisodeRules, emulator: Emulator, random: Sequence[np.random.Generator]
) -> Float[np.ndarray, "R S"]:
    """Return the starts that `rules` draw from each of `random`, with parts that are tied together meeting.

    Raises ArgumentError for rules that draw no starts, or other states than the emulator's.
    """
    if rules.draw_start is None:
        raise ArgumentError("rules: wanted rules with draw_start, which draws starts.")
    starts = np.stack([rules.draw_start(rng) for rng in random])
    return closed_starts(
        emulator.spec, emulator.state.check(starts, "rules.draw_start"), tied_system(emulator.spec)
    )


Reward = Callable[[Array, Array, Array], Any]
"""Function of the state (S,), the control (C,) and the state (S,) one super step later that returns a number.

It is written in jax.numpy, as it is compiled.
"""


class RunningCost(eqx.Module):
    """The reward −Δt · J, where J is the objective of this one super step as if it lasted a second.

    So a return is −∫ (μ_u/2 |u|² + μ_s/2 |s − s_d|²) dt for any super step. Without an objective it is −∫ |u|²/2 dt, with
    u in units of its limits.
    """

    objective: Objective | None
    control_scale: Float[AnyArray, " C"]
    """Full effort of each control."""
    dt: float = eqx.field(static=True)

    @classmethod
    def of(cls, emulator: Emulator, objective: Objective | None = None) -> RunningCost:
        """Return the reward that fits `emulator`."""
        control_scale = jnp.asarray(emulator.bounds.magnitude, jnp.float32)
        return cls(objective, control_scale, emulator.dt)

    def __call__(
        self, state: Float[Array, " S"], control: Float[Array, " C"], following: Float[Array, " S"]
    ) -> Float[Array, ""]:
        """Return the reward of going from `state` to `following`."""
        if self.objective is None:
            return effort_reward(control, self.control_scale, self.dt)
        states = jnp.stack([state, following])
        trajectory = Trajectory(states, control[None], self.control_scale, 1.0)
        return -self.dt * self.objective(trajectory)


def effort_reward(
    control: Float[AnyArray, "*B C"], scale: Float[AnyArray, " C"], dt: float
) -> Float[AnyArray, "*B"]:
    """Return −Δt/2 |u|², the controls measured in `scale`."""
    return -dt * ((control / scale) ** 2).sum(axis=-1) / 2


def rules_by(
    emulator: Emulator,
    objective: Objective | None,
    reward: Reward | None,
    rules: EpisodeRules | None,
) -> EpisodeRules:
    """Return the rules of episodes: those given, or those of an objective or a reward alone."""
    given = {"objective": objective, "reward": reward, "rules": rules}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise ArgumentError(f"{names[0]} and {names[1]}: got both. Give one of them.")
    if rules is not None:
        return rules
    return EpisodeRules(partial(_reward_rows, reward or RunningCost.of(emulator, objective)))


def _reward_rows(
    reward: Reward,
    states: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B C"],
    following: Float[np.ndarray, "B S"],
    dt: float,
) -> Float[np.ndarray, " B"]:
    """Return the rewards of many rows, by a reward of one."""
    if isinstance(reward, RunningCost) and reward.objective is None:
        return effort_reward(controls, np.asarray(reward.control_scale), reward.dt)
    return np.asarray(_rewards(reward, states, controls, following))


@eqx.filter_jit
def _rewards(
    reward: Reward,
    states: Float[AnyArray, "B S"],
    controls: Float[AnyArray, "B C"],
    following: Float[AnyArray, "B S"],
) -> Any:
    return eqx.filter_vmap(reward)(states, controls, following)
