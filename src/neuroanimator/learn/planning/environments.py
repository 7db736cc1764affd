"""Planning in a Gymnasium environment, or in any object with reset, step and a readable state.

    episode = control_environment(planner, environment, 500, state_of=read_state)

An environment is independent of the emulator: its reward is not the objective, its reset may begin outside of training,
and only its observations are known. So an emulator can be trained on what was observed there, see `learn_from`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from neuroanimator.control.objective.objective import Objective
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.planning.planner import Planner, moved_on

SAME_TIME = 1e-6
"""Relative difference up to which two times count as equal."""

SAME_RANGE = 1e-3
"""Share of a control's range by which it may exceed an action's: single precision rounds."""

RESULTS = 5
"""Number of results of a Gymnasium step: observation, reward, terminated, truncated, infos."""


@runtime_checkable
class Environment(Protocol):
    """The controlled environment, with Gymnasium's signatures."""

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; return an observation and infos."""
        ...

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take one step; return observation, reward, whether it terminated, whether it was truncated, and infos."""
        ...


StateReader = Callable[[Any, Any], Float[np.ndarray, " S"]]
"""(environment, observation) → the emulator's state."""

ObjectiveReader = Callable[[Any, Any], Objective]
"""(environment, first observation) → the planner's costs with the numbers of this episode, such as its target."""


@dataclass(frozen=True)
class DmEnvironment:
    """A dm_control environment as a Gymnasium one."""

    unwrapped: Any
    """Environment whose `reset()` and `step(action)` return time steps."""

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode. `seed` has no effect: the environment's task was given its own when it was made."""
        return self.unwrapped.reset().observation, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take one step. An episode that ends at a discount of 1 was truncated: it would have gone on."""
        moment = self.unwrapped.step(action)
        is_last = moment.last()
        is_truncated = is_last and moment.discount == 1
        return moment.observation, moment.reward, is_last and not is_truncated, is_truncated, {}


def mujoco_state(environment: Any, observation: Any) -> Float[np.ndarray, " S"]:
    """Return positions, velocities and activations of the MuJoCo model inside an environment of Gymnasium or dm_control.

    Raises ArgumentError if there is none.
    """
    inner = getattr(environment, "unwrapped", environment)
    data: Any = getattr(getattr(inner, "physics", inner), "data", None)
    if not all(hasattr(data, part) for part in ("qpos", "qvel", "act")):
        raise ArgumentError(
            f"state_of: no MuJoCo data in {type(inner).__name__}. Wanted a function (environment, observation) → state."
        )
    return np.concatenate([data.qpos, data.qvel, data.act], dtype=float)


@dataclass(frozen=True)
class Episode:
    """An episode of a planner in an environment, by super steps."""

    controls: Float[np.ndarray, "N C"]
    states: Float[np.ndarray, "N+1 S"]
    """States as read before each control, and after the last."""
    rewards: Float[np.ndarray, " N"]
    """Rewards of the environment, summed over each super step."""
    plan_seconds: Float[np.ndarray, " P"]
    """Time of each plan [s]."""
    is_terminated: bool
    """Whether the environment ended it, rather than the time limit."""
    environment_steps: int
    whole_steps: int
    """Number of whole super steps, N or one less: an environment may end within the last one."""

    @property
    def total_reward(self) -> float:
        """The episode's return, undiscounted."""
        return float(self.rewards.sum())


def control_environment(
    planner: Planner,
    environment: Environment,
    steps: int,
    *,
    state_of: StateReader = mujoco_state,
    objective_of: ObjectiveReader | None = None,
    hold: int | None = None,
    every: int = 1,
    seed: int | None = None,
    on_step: Callable[[int, float], None] = lambda step, reward: None,
) -> Episode:
    """Return one episode of at most `steps` super steps, replanned from the state as read at each, or at `every` such number.

    Planning less often leaves time for better plans, and carries out what they prepare: a plan that is replaced at
    every step may postpone it for ever. A super step of the emulator is `hold` steps of the environment, under one
    control; the default follows from its `dt`, or `control_timestep`. `objective_of` makes the episode's own
    objective from its first observation. `on_step` is called with (super step, its reward).

    Raises ArgumentError for an environment that does not return what Gymnasium's do, for states and actions of
    another size than the emulator's, for states that are not finite, and for steps that do not fill a super step.
    """
    if hold is None:
        hold = _steps_in(planner.emulator.dt, environment)
    if min(steps, hold) < 1:
        raise ArgumentError(f"steps and hold: wanted at least 1, got {steps} and {hold}.")
    if not 1 <= every <= planner.parametrisation.steps:
        raise ArgumentError(
            f"every: wanted 1 to the {planner.parametrisation.steps} super steps of a plan, got {every}."
        )
    check_actions(planner.emulator, environment)
    observation = _reset(environment, seed)
    if objective_of is not None:
        planner = planner.towards(objective_of(environment, observation))
    state = _read(planner, state_of, environment, observation)
    states = [state]
    controls = []
    rewards = []
    seconds = []
    taken = 0
    whole = 0
    first = None
    moment = _Moment(observation, 0.0, 0, is_terminated=False, is_over=False)
    while len(controls) < steps and not moment.is_over:
        plan = planner.plan(state, first)
        seconds.append(plan.seconds)
        first = moved_on(plan.controls, every)
        for control in plan.controls[: min(every, steps - len(controls))].astype(float):
            moment = _hold(environment, control, hold)
            state = _read(planner, state_of, environment, moment.observation)
            states.append(state)
            controls.append(control)
            rewards.append(moment.reward)
            taken += moment.steps
            whole += moment.steps == hold
            on_step(len(controls), moment.reward)
            if moment.is_over:
                break
    return Episode(
        np.stack(controls),
        np.stack(states),
        np.array(rewards),
        np.array(seconds),
        moment.is_terminated,
        taken,
        whole,
    )


def _steps_in(dt: float, environment: Environment) -> int:
    """Return the number of steps of the environment in `dt` [s]; 1 if it does not declare the length of a step."""
    inner = getattr(environment, "unwrapped", environment)
    step = getattr(inner, "dt", None)
    if hasattr(inner, "control_timestep"):
        step = inner.control_timestep()
    if not isinstance(step, float) or not step > 0:
        return 1
    count = round(dt / step)
    if count < 1 or abs(count * step - dt) > SAME_TIME * dt:
        raise ArgumentError(
            f"environment: the emulator's super step of {dt:g} s is not a whole multiple of its step of {step:g} s. "
            "Train with --substeps that make it one."
        )
    return count


class _Moment(NamedTuple):
    """The outcome of one or several steps of an environment."""

    observation: Any
    reward: float
    steps: int
    is_terminated: bool
    is_over: bool


def _reset(environment: Environment, seed: int | None) -> Any:
    """Return the first observation."""
    result = environment.reset(seed=seed)
    if not isinstance(result, tuple) or len(result) != 2:
        raise ArgumentError(
            f"environment.reset: wanted (observation, info) as Gymnasium has it, got {_form(result)}. "
            "Wrap dm_control's in DmEnvironment."
        )
    observation = result[0]
    _check_observation(environment, observation, "reset")
    return observation


def _hold(environment: Environment, control: Float[np.ndarray, " C"], steps: int) -> _Moment:
    """Return the outcome of `steps` steps under one control, or fewer if the episode ends; rewards are summed."""
    moment = _step(environment, control)
    while moment.steps < steps and not moment.is_over:
        following = _step(environment, control)
        reward = moment.reward + following.reward
        moment = following._replace(reward=reward, steps=moment.steps + 1)
    return moment


def _step(environment: Environment, control: Float[np.ndarray, " C"]) -> _Moment:
    result = environment.step(control)
    if not isinstance(result, tuple) or len(result) != RESULTS:
        raise ArgumentError(
            "environment.step: wanted (observation, reward, terminated, truncated, info) as Gymnasium has it, "
            f"got {_form(result)}. Wrap dm_control's in DmEnvironment."
        )
    observation, reward, is_terminated, is_truncated, _ = result
    if np.ndim(reward) or not np.isfinite(reward):
        raise ArgumentError(
            f"environment.step: wanted a finite number as reward, got {_form(reward)}."
        )
    for flag in (is_terminated, is_truncated):
        if np.ndim(flag):
            raise ArgumentError(
                f"environment.step: wanted True or False as terminated and truncated, got {_form(flag)}."
            )
    _check_observation(environment, observation, "step")
    is_over = bool(is_terminated) or bool(is_truncated)
    return _Moment(observation, float(reward), 1, bool(is_terminated), is_over)


def _check_observation(environment: Environment, observation: Any, method: str) -> None:
    """Refuse an observation of another shape than the environment declares, if it declares one."""
    space = getattr(environment, "observation_space", None)
    declared = getattr(space, "shape", None)
    if declared is None:
        return
    try:
        shape = np.shape(observation)
    except ValueError:
        shape = None  # rows of unequal length
    if shape != tuple(declared):
        raise ArgumentError(
            f"environment.{method}: its observation_space has shape {tuple(declared)}, the observation {shape}. Correct the "
            "environment: what reads a state of it relies on that."
        )


def _form(value: Any) -> str:
    """Return the kind of `value` in a few words."""
    if isinstance(value, tuple):
        return f"{len(value)} things"
    if np.ndim(value):
        return f"an array of shape {np.shape(value)}"
    if isinstance(value, float | np.floating):
        return f"{value:g}"
    return type(value).__name__


def _read(
    planner: Planner, state_of: StateReader, environment: Environment, observation: Any
) -> Float[np.ndarray, " S"]:
    """Return the state as `state_of` reads it, checked."""
    state = np.asarray(state_of(environment, observation), float)
    return planner.emulator.state.check(state, "state_of")


def check_actions(emulator: Emulator, environment: Environment) -> None:
    """Refuse an environment whose declared actions are not the emulator's controls."""
    space = getattr(environment, "action_space", None)
    size = emulator.control.size
    if space is None:
        return
    shape = getattr(space, "shape", None)
    if shape is None or tuple(shape) != (size,):
        told = (
            f"have shape {tuple(shape)}" if shape is not None else f"are a {type(space).__name__}"
        )
        raise ArgumentError(
            f"environment: its actions {told}, the emulator {size} controls. Train on the environment's own model."
        )
    _check_action_range(emulator, space)


def _check_action_range(emulator: Emulator, space: Any) -> None:
    """Refuse an environment whose declared range of actions is smaller than that of the emulator's controls."""
    bounds = emulator.bounds
    low = np.asarray(getattr(space, "low", -np.inf), float)
    high = np.asarray(getattr(space, "high", np.inf), float)
    margin = SAME_RANGE * bounds.half
    is_outside = (np.array(bounds.low) < low - margin) | (np.array(bounds.high) > high + margin)
    if is_outside.any():
        entry = int(np.argmax(is_outside))
        least = np.broadcast_to(low, margin.shape)[entry]
        most = np.broadcast_to(high, margin.shape)[entry]
        raise ArgumentError(
            f"environment: its action {entry} goes from {least:g} to {most:g}, the emulator's "
            f"{emulator.control.names[entry]} from {bounds.low[entry]:g} to {bounds.high[entry]:g}. Train with the "
            "environment's own range, or let it take controls in their own units."
        )
