"""What makes physics a task: what is observed, what a step earns, where episodes begin and when they end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from neuroanimator.control.objective.objective import Objective, Trajectory
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray

RowReward = Callable[
    [Float[np.ndarray, "B S"], Float[np.ndarray, "B C"], Float[np.ndarray, "B S"], float],
    Float[np.ndarray, " B"],
]
"""(states, controls, states one step later, duration of that step [s]) → rewards, in NumPy, of many rows at once."""

Observer = Callable[[Float[np.ndarray, "B S"]], Float[np.ndarray, "B O"]]
"""States → what a policy is shown of them."""

Ending = Callable[[Float[np.ndarray, "B S"]], Bool[np.ndarray, " B"]]
"""States after a step → whether the episode is over, as the task has it."""

StartDraw = Callable[[np.random.Generator], Float[np.ndarray, " S"]]
"""Random numbers → the state an episode begins with."""


Disturbance = Callable[[np.random.Generator, Float[np.ndarray, "B S"]], Float[np.ndarray, "B S"]]
"""(random numbers, states between two steps) → the states as the task changes them."""


def whole_state(states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B S"]:
    """Return the states: all of them is observed."""
    return states


def never(states: Float[np.ndarray, "B S"]) -> Bool[np.ndarray, " B"]:
    """Return that no row is over."""
    return np.zeros(len(states), bool)


def unpaid(
    states: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B C"],
    following: Float[np.ndarray, "B S"],
    dt: float,
) -> Float[np.ndarray, " B"]:
    """Return a reward of zero: rewards are computed elsewhere, or do not matter."""
    return np.zeros(len(states))


@dataclass(frozen=True)
class EpisodeRules:
    """A task in functions of many rows: whatever physics steps the states, the same rules hold.

    A policy learnt in an emulator by the rules of an environment acts in that environment as it is.
    """

    reward: RowReward
    observe: Observer = whole_state
    is_over: Ending = never
    draw_start: StartDraw | None = None
    """None: near rest, see `starts_near_rest`."""
    steps: int | None = None
    """Super steps after which an episode is truncated; None: as many as fill the usual time."""
    is_cut: Ending = never
    """Where episodes are truncated, besides after `steps`; of policies that are learnt."""
    disturb: Disturbance | None = None
    """What happens to bodies between two steps, such as other commands; of policies that are learnt."""


Reward = Callable[[Array, Array, Array], Any]
"""A function of the state (S,), the control (C,) and the state (S,) one super step later that returns a number.

It is written in jax.numpy, since it is compiled.
"""


class RunningCost(eqx.Module):
    """The reward −Δt · J, where J is the objective of this one super step taken as if it lasted a second.

    So a return is −∫ (μ_u/2 |u|² + μ_s/2 |s − s_d|²) dt, whatever the super step. Without an objective
    it is −∫ |u|²/2 dt, u measured against its limits.
    """

    objective: Objective | None
    control_scale: Float[AnyArray, " C"]
    """What counts as full effort of each control."""
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
    """Return the rules by which episodes go: those given, or what an objective or a reward alone makes."""
    given = {"objective": objective, "reward": reward, "rules": rules}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise ArgumentError(f"{names[0]} and {names[1]}: both came. Give one of them.")
    if rules is not None:
        return rules
    return EpisodeRules(_of_rows(reward or RunningCost.of(emulator, objective)))


def _of_rows(reward: Reward) -> RowReward:
    """Return a reward of one row as one of many."""

    def reward_rows(
        states: Float[np.ndarray, "B S"],
        controls: Float[np.ndarray, "B C"],
        following: Float[np.ndarray, "B S"],
        dt: float,
    ) -> Float[np.ndarray, " B"]:
        if isinstance(reward, RunningCost) and reward.objective is None:
            return effort_reward(controls, np.asarray(reward.control_scale), reward.dt)
        return np.asarray(_rewards(reward, states, controls, following))

    return reward_rows


@eqx.filter_jit
def _rewards(
    reward: Reward,
    states: Float[AnyArray, "B S"],
    controls: Float[AnyArray, "B C"],
    following: Float[AnyArray, "B S"],
) -> Any:
    return eqx.filter_vmap(reward)(states, controls, following)
