"""An emulator as a Gymnasium environment: the state is observed, and the objective or the user says what it earns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode
from jaxtyping import Array, Bool, Float

from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.emulator import Emulator, as_emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.rows import step_rows
from neuroanimator.gym.rules import EpisodeRules, RowReward
from neuroanimator.gym.single_env import SingleEnv
from neuroanimator.gym.state_env import NOISE, Leap, StateVectorEnv
from neuroanimator.state.arrays import AnyArray

MAX_PENALISED = 10.0
"""Scores above it lose no more: the error has long been larger than what is to be learnt."""

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


@final
class EmulatorVectorEnv(StateVectorEnv):
    """`num_envs` emulated systems in one compiled call; row i is an `EmulatorEnv` reset with seed + i.

    A row that has ended starts anew in the next step, whose action it ignores and whose reward is zero; or in the same
    step, as Gymnasium's `AutoresetMode.SAME_STEP` has it: `info["final_obs"]` is then the last observation.
    """

    def __init__(
        self,
        emulator: Emulator | str | Path,
        num_envs: int = 1,
        objective: Objective | None = None,
        reward: Reward | None = None,
        seconds: float | None = None,
        noise: float = NOISE,
        render_mode: str | None = None,
        *,
        rules: EpisodeRules | None = None,
        trust_limit: float = np.inf,
        trust_penalty: float = 0.0,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    ):
        """Make it from what an `EmulatorEnv` is made from; `autoreset_mode` says when a row that ended starts anew."""
        emulator = as_emulator(emulator)
        super().__init__(
            emulator,
            num_envs,
            rules_by(emulator, objective, reward, rules),
            seconds,
            noise,
            render_mode,
            autoreset_mode,
        )
        if not trust_limit > 0 or not 0 <= trust_penalty < np.inf:
            raise ArgumentError(
                "trust_limit and trust_penalty: wanted a score above 0 and a penalty of 0 or more, "
                f"came {trust_limit:g} and {trust_penalty:g}."
            )
        self.trust_limit = trust_limit
        self.trust_penalty = trust_penalty

    def begin_rows(
        self, states: Float[np.ndarray, "B S"], rows: Bool[np.ndarray, " B"]
    ) -> Float[np.ndarray, "B S"]:
        states = states.astype(np.float32)
        if rows.all():
            # Kept from step to step: a latent state, decoded and encoded again, is no longer quite the same.
            self._latent = np.array(self.emulator.encode(states), np.float32)
        else:
            self._latent[rows] = self.emulator.encode(states[rows])
        return states

    def leap(self, states: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B C"]) -> Leap:
        made = step_rows(self.emulator, self._latent, controls)
        self._latent = made.latent
        # What is no number is beyond every limit.
        trust = np.nan_to_num(made.trust, nan=np.inf)
        beyond = np.clip(trust, EDGE, MAX_PENALISED) - EDGE
        is_lost = made.begins_far | made.ends_far | (trust > self.trust_limit)
        info = {"covered": trust <= EDGE, "trust": made.trust}
        return Leap(made.states, is_lost, self.trust_penalty * beyond, info)


@final
class EmulatorEnv(SingleEnv):
    """One emulated system; a step is a super step, an observation the state, an action the control, SI units.

    An episode starts near rest, or where `reset(options={"state": ...})` says. It is truncated after
    `seconds`, and terminated where the state is no number or far (`rows.FAR`) outside what the emulator was
    trained on. `info["trust"]` says how far the step lies from that, `info["covered"]` whether
    within its edge, 1. Actions are clipped to the bounds.
    Observations have no bounds, since a free body may go anywhere: `emulator.state` names each
    number and its unit. The tasks of `task_envs` see the body from its own frame, within bounds.
    """

    def __init__(
        self,
        emulator: Emulator | str | Path,
        objective: Objective | None = None,
        reward: Reward | None = None,
        seconds: float | None = None,
        noise: float = NOISE,
        render_mode: str | None = None,
        *,
        rules: EpisodeRules | None = None,
        trust_limit: float = np.inf,
        trust_penalty: float = 0.0,
    ):
        """Make it from an emulator, its file, or a shipped one's name.

        The reward is the `RunningCost` of `objective`, or what `reward` returns. `rules` say more than a reward: what is
        observed, where episodes begin and end. An episode is also terminated by a step whose score is above
        `trust_limit`, and each step loses `trust_penalty` times how far its score is beyond the edge of training, 1.
        """
        self._row = EmulatorVectorEnv(
            emulator,
            1,
            objective,
            reward,
            seconds,
            noise,
            render_mode,
            rules=rules,
            trust_limit=trust_limit,
            trust_penalty=trust_penalty,
        )
        super().__init__(self._row)

    def draw_start(self) -> dict[str, Any]:
        return {"state": self._row.draw_starts([self.np_random])[0]}
