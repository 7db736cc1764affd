"""An emulator as a Gymnasium environment: the state is observed, and the objective or the user says what it earns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, final

import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust import EDGE
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.rows import step_rows
from neuroanimator.gym.single_env import SingleEnv
from neuroanimator.gym.vector_env import EmulatedVectorEnv, check_reset_options
from neuroanimator.jax_later import Array, eqx, filter_jit, jnp
from neuroanimator.pytrees import Module, static
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.slowness import slowness
from neuroanimator.zoo import find_emulator

SECONDS = 10.0
"""Length of an episode if nothing else is said [s]; of a slow system longer."""

NOISE = 0.1
"""How far starts lie from rest, in standard deviations of the change in one super step: visible, but hardly."""

Reward = Callable[[Array, Array, Array], Any]
"""A function of the state (S,), the control (C,) and the state (S,) one super step later that returns a number.

It is written in jax.numpy, since it is compiled.
"""


class RunningCost(Module):
    """The reward −Δt · J, where J is the objective of this one super step taken as if it lasted a second.

    So a return is −∫ (μ_u/2 |u|² + μ_s/2 |s − s_d|²) dt, whatever the super step. Without an objective
    it is −∫ |u|²/2 dt, u measured against its limits.
    """

    objective: Objective | None
    control_scale: Float[AnyArray, " C"]
    """What counts as full effort of each control."""
    dt: float = static()

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


@filter_jit
def _rewards(
    reward: Reward,
    states: Float[AnyArray, "B S"],
    controls: Float[AnyArray, "B C"],
    following: Float[AnyArray, "B S"],
) -> Any:
    return eqx.filter_vmap(reward)(states, controls, following)


@final
class EmulatorVectorEnv(EmulatedVectorEnv):
    """`num_envs` emulated systems in one compiled call; row i is an `EmulatorEnv` reset with seed + i.

    A row that has ended starts anew in the next step, whose action it ignores and whose reward is zero.
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
    ):
        """Make it from what an `EmulatorEnv` is made from."""
        if not isinstance(emulator, Emulator):
            emulator = Emulator.load(find_emulator(str(emulator)))
        super().__init__(emulator, num_envs, render_mode)
        if objective is not None and reward is not None:
            raise ArgumentError("objective and reward: both came. Give one of them.")
        if seconds is None:
            seconds = SECONDS * slowness(emulator.dt)
        if not emulator.dt <= seconds < np.inf:
            raise ArgumentError(
                f"seconds: wanted at least one super step of {emulator.dt:g} s, came {seconds:g}."
            )
        self.noise = noise
        self.reward = reward or RunningCost.of(emulator, objective)
        self.steps = round(seconds / emulator.dt)
        self.set_observation_space(Box(-np.inf, np.inf, (emulator.state.size,), np.float32))
        self._begin(emulator.rest)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, "B S"], dict[str, Any]]:
        """Return (states, {}), near rest or as `options["state"]` (S,) or (B, S) says."""
        self._seed_rows(seed)
        check_reset_options(options, "state")
        if options:
            self._begin(self.emulator.state.check(options["state"], "state"))
        else:
            self._begin(starts_near_rest(self.emulator, self.noise, self._random))
        return self._states.copy(), {}

    def step(
        self, actions: ArrayLike
    ) -> tuple[
        Float[np.ndarray, "B S"],
        Float[np.ndarray, " B"],
        Bool[np.ndarray, " B"],
        Bool[np.ndarray, " B"],
        dict[str, Any],
    ]:
        """Return (states, rewards, terminated, truncated, info) after `actions` (B, C) were held for a super step."""
        controls = self._checked_actions(actions).astype(np.float32)
        made = step_rows(self.emulator, self._latent, controls)
        rewards = self._rewards(controls, made.states)
        is_far = made.begins_far | made.ends_far
        is_new = self._has_ended
        self._states = made.states
        self._latent = made.latent
        if is_new.any():
            random = [self._random[row] for row in np.flatnonzero(is_new)]
            self._states[is_new] = starts_near_rest(self.emulator, self.noise, random)
            self._latent[is_new] = self.emulator.encode(self._states[is_new])
        self._steps = np.where(is_new, 0, self._steps + 1)
        terminated = is_far & ~is_new
        truncated = self._steps >= self.steps
        self._has_ended = terminated | truncated
        info = {"covered": (made.trust <= EDGE) & ~is_new, "trust": made.trust}
        info |= {f"_{name}": ~is_new for name in list(info)}
        return self._states.copy(), np.where(is_new, 0.0, rewards), terminated, truncated, info

    def shown_states(self) -> Float[np.ndarray, "B S"]:
        return self._states

    def _rewards(
        self, controls: Float[np.ndarray, "B C"], following: Float[np.ndarray, "B S"]
    ) -> Float[np.ndarray, " B"]:
        """Return the rewards of going from the present states to the `following` ones."""
        reward = self.reward
        if isinstance(reward, RunningCost) and reward.objective is None:
            return effort_reward(controls, np.asarray(reward.control_scale), reward.dt)
        return np.asarray(_rewards(reward, self._states, controls, following))

    def _begin(self, states: Float[np.ndarray, "*B S"]) -> None:
        """Begin an episode in each row at `states` (S,) or (B, S)."""
        shape = self.observation_space.shape or ()
        if states.shape not in (shape, shape[1:]):
            raise ArgumentError(f"state: wanted shape {shape[1:]} or {shape}, came {states.shape}.")
        self._states = np.broadcast_to(states, shape).astype(np.float32)
        # Kept from step to step: a latent state, decoded and encoded again, is no longer quite the same.
        self._latent = np.array(self.emulator.encode(self._states), np.float32)
        self._steps = np.zeros(self.num_envs, int)
        self._has_ended = np.zeros(self.num_envs, bool)


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
    ):
        """Make it from an emulator, its file, or a shipped one's name.

        The reward is the `RunningCost` of `objective`, or what `reward` returns.
        """
        self._row = EmulatorVectorEnv(emulator, 1, objective, reward, seconds, noise, render_mode)
        super().__init__(self._row)

    def draw_start(self) -> dict[str, Any]:
        return {"state": start_near_rest(self._row.emulator, self._row.noise, self.np_random)}


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
