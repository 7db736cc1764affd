"""An emulator as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, final

import equinox as eqx
import gymnasium
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.film.live import Camera, checked_render_mode
from neuroanimator.gym.episodes import FAR
from neuroanimator.zoo import find_emulator

SECONDS = 10.0
"""[s] Length of an episode."""

NOISE = 0.1
"""How far starts lie from rest, in standard deviations of the change in one super step: seen, but hardly."""

Reward = Callable[[Array, Array, Array], Any]
"""(state (S,), control (C,), state one super step later (S,)) → a number. Written in jax.numpy: it is compiled."""


class RunningCost(eqx.Module):
    """The reward −Δt · J, where J is the objective of this one super step taken as if it lasted a second.

    So a return is −∫ (μ_u/2 |u|² + μ_s/2 |s − s_d|²) dt, whatever the super step. Without an objective
    it is −∫ |u|²/2 dt, u measured against its limits.
    """

    objective: Objective | None
    control_scale: Float[Array, " C"]
    dt: float = eqx.field(static=True)

    @classmethod
    def of(cls, emulator: Emulator, objective: Objective | None = None) -> RunningCost:
        """Return the reward that fits `emulator`."""
        return cls(objective, jnp.asarray(emulator.bounds.magnitude, jnp.float32), emulator.dt)

    def __call__(
        self, state: Float[Array, " S"], control: Float[Array, " C"], following: Float[Array, " S"]
    ) -> Array:
        """Return the reward of going from `state` to `following`."""
        if self.objective is None:
            return -self.dt * jnp.sum((control / self.control_scale) ** 2) / 2
        return -self.dt * self.objective(
            Trajectory(jnp.stack([state, following]), control[None], self.control_scale, 1.0)
        )


def _advance(
    emulator: Emulator,
    reward: Reward,
    state: Float[Array, " S"],
    latent: Float[Array, " I"],
    control: Float[Array, " C"],
) -> tuple:
    """Return (next state, its inner numbers, reward, whether training covered the step, whether it was far away).

    A step is far away by where it begins, too: what it ends in is kept within the range of training.
    """
    held = emulator.encode_control(control)
    following = emulator.step_latent(latent, held)
    after = emulator.decode(following)
    low, high = emulator.domain.widened(FAR, slice(None))
    seen = jnp.stack([emulator.seen(latent, held), emulator.seen(following, held)])
    is_near = jnp.all((seen >= low) & (seen <= high) & jnp.isfinite(seen))
    is_far = ~(is_near & jnp.all(jnp.isfinite(after)))
    return after, following, reward(state, control, after), emulator.covers_encoded(latent), is_far


_advance_batch = eqx.filter_jit(eqx.filter_vmap(_advance, in_axes=(None, None, 0, 0, 0)))


@final
class EmulatorVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` emulated systems in one compiled call; row i is an `EmulatorEnv` reset with seed + i.

    A row that has ended starts anew in the next step, whose action it ignores and whose reward is zero.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        emulator: Emulator | str | Path,
        num_envs: int = 1,
        objective: Objective | None = None,
        reward: Reward | None = None,
        seconds: float = SECONDS,
        noise: float = NOISE,
        render_mode: str | None = None,
    ):
        """Make it from what an `EmulatorEnv` is made from."""
        if not isinstance(emulator, Emulator):
            emulator = Emulator.load(find_emulator(str(emulator)))
        if num_envs < 1:
            raise ArgumentError(f"num_envs: wanted one or more, came {num_envs}.")
        if objective is not None and reward is not None:
            raise ArgumentError("objective and reward: both came. Give one of them.")
        if not emulator.dt <= seconds < np.inf:
            raise ArgumentError(
                f"seconds: wanted at least one super step of {emulator.dt:g} s, came {seconds:g}."
            )
        self.emulator, self.num_envs, self.noise = emulator, num_envs, noise
        self.render_mode = checked_render_mode(render_mode)
        self.metadata = {**self.metadata, "render_fps": round(1 / emulator.dt)}
        self._camera = Camera(emulator.spec)
        self.reward = reward or RunningCost.of(emulator, objective)
        self.steps = round(seconds / emulator.dt)
        bounds = emulator.bounds
        low, high = np.array(bounds.low, np.float32), np.array(bounds.high, np.float32)
        self.single_action_space = Box(low, high, dtype=np.float32)
        self.single_observation_space = Box(-np.inf, np.inf, (emulator.state.size,), np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._random = [np_random()[0] for _ in range(num_envs)]
        self._place(emulator.rest)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return (states (B, S), {}), near rest or as `options["state"]` (S,) or (B, S) says."""
        if seed is not None:
            self._random = [np_random(seed + row)[0] for row in range(self.num_envs)]
        unknown = set(options or {}) - {"state"}
        if unknown:
            raise ArgumentError(f"No reset option called '{unknown.pop()}'. Options: state.")
        if options:
            self._place(self.emulator.state.check(options["state"], "state"))
        else:
            self._place(
                np.stack(
                    [start_near_rest(self.emulator, self.noise, random) for random in self._random]
                )
            )
        return self._states.copy(), {}

    def step(
        self, actions: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Return (states (B, S), rewards, terminated, truncated, info), each (B,), after `actions` (B, C)."""
        states, latent, rewards, is_covered, is_far = _advance_batch(
            self.emulator, self.reward, self._states, self._inner, self._controls(actions)
        )
        is_new, self._states, self._inner = self._has_ended, np.array(states), np.array(latent)
        for row in np.flatnonzero(is_new):
            self._states[row] = start_near_rest(self.emulator, self.noise, self._random[row])
            self._inner[row] = self.emulator.encode(self._states[row])
        self._steps = np.where(is_new, 0, self._steps + 1)
        terminated, truncated = np.asarray(is_far) & ~is_new, self._steps >= self.steps
        self._has_ended = terminated | truncated
        info = {"covered": np.asarray(is_covered) & ~is_new, "_covered": ~is_new}
        return self._states.copy(), np.where(is_new, 0.0, rewards), terminated, truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture (H, W, 3) of each row if `render_mode` is `rgb_array`; ResourceError without graphics."""
        if self.render_mode is None:
            return None
        return tuple(self._camera.picture(state) for state in self._states)

    def close_extras(self, **_: Any) -> None:
        """End the drawing process."""
        self._camera.close()

    def _place(self, states: np.ndarray) -> None:
        """Begin an episode in each row at `states` (S,) or (B, S)."""
        shape = self.observation_space.shape or ()
        if states.shape not in (shape, shape[1:]):
            raise ArgumentError(f"state: wanted shape {shape[1:]} or {shape}, came {states.shape}.")
        self._states = np.broadcast_to(states, shape).astype(np.float32)
        # Kept from step to step: a body's few numbers, decoded and encoded again, are no longer quite the same.
        self._inner = self.emulator.encode(self._states)
        self._steps, self._has_ended = np.zeros(self.num_envs, int), np.zeros(self.num_envs, bool)

    def _controls(self, actions: ArrayLike) -> np.ndarray:
        """Return `actions` (B, C), brought within the bounds as a motor would."""
        controls = self.emulator.control.check(actions, "action")
        if controls.shape != self.action_space.shape:
            raise ArgumentError(
                f"action: wanted shape {self.action_space.shape}, came {controls.shape}."
            )
        return self.emulator.bounds.clip(controls).astype(np.float32)


@final
class EmulatorEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One emulated system; a step is a super step, an observation the state, an action the control, SI units.

    An episode starts near rest, or where `reset(options={"state": ...})` says. It is truncated after
    `seconds`, and terminated where the state is no number or far (`FAR`) outside what the emulator was
    trained on. `info["covered"]` says whether training covered the step. Actions are clipped to the bounds.
    Observations have no bounds, since a free body may go anywhere: `emulator.state` names each
    number and its unit. The tasks of `gym_tasks` see the body from its own frame, within bounds.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(
        self,
        emulator: Emulator | str | Path,
        objective: Objective | None = None,
        reward: Reward | None = None,
        seconds: float = SECONDS,
        noise: float = NOISE,
        render_mode: str | None = None,
    ):
        """Make it from an emulator, its file, or a shipped one's name.

        The reward is the `RunningCost` of `objective`, or what `reward` returns.
        """
        self._envs = EmulatorVectorEnv(emulator, 1, objective, reward, seconds, noise, render_mode)
        self.render_mode = self._envs.render_mode
        self.metadata = {**self.metadata, "render_fps": self._envs.metadata["render_fps"]}
        self.observation_space = self._envs.single_observation_space
        self.action_space = self._envs.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return (state (S,), {}). The same seed gives the same start."""
        super().reset(seed=seed)
        start = start_near_rest(self._envs.emulator, self._envs.noise, self.np_random)
        states, info = self._envs.reset(options={"state": start, **(options or {})})
        return states[0], info

    def step(self, action: ArrayLike) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Return (state (S,), reward, terminated, truncated, info) after `action` (C,) was held for a super step."""
        states, rewards, terminated, truncated, info = self._envs.step(np.asarray(action)[None])
        is_covered = bool(info["covered"][0])
        return (
            states[0],
            float(rewards[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            {"covered": is_covered},
        )

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a picture (H, W, 3) in uint8 if `render_mode` is `rgb_array`; ResourceError if none can be drawn."""
        pictures = self._envs.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """End the drawing process."""
        self._envs.close()


def start_near_rest(emulator: Emulator, noise: float, random: np.random.Generator) -> np.ndarray:
    """Return rest (S,) with noise along what a state can change by, so that quaternions stay of length one.

    A deformable body is moved by what noise does to its few numbers, which cannot show rest itself exactly.
    """
    frame = replace(
        emulator.frame, dt=0.0
    )  # noise is drawn around rest as it is, not as it would coast
    unit, rest = np.asarray(emulator.normaliser.unit, float), emulator.rest
    changes = np.stack([np.zeros_like(unit), noise * unit * random.normal(size=unit.shape)])
    still, moved = emulator.decode(frame.apply(np.tile(emulator.encode(rest), (2, 1)), changes))
    return rest + (moved - still)
