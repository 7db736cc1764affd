"""Going forward without falling: the tasks of Gymnasium's MuJoCo environments, as rules of episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.definitions.carried import read_definition_text
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.task import ANY, FARTHEST, TaskTable
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.models import default_of
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.parameters import Parameter, draw_parameters
from neuroanimator.state.structure import Structure

FREE_ROOT = 7
"""Size of a free root's position and quaternion."""


def gymnasium_task(env_id: str) -> TaskTable:
    """Return the task of Gymnasium's environment `env_id`, such as `Hopper-v5`: its weights and limits.

    Its cost of contact forces is left out. Raises ArgumentError for an environment that rewards anything but going
    forward.
    """
    if default_of(env_id, "forward_reward_weight") is None:
        raise ArgumentError(
            f"{env_id} rewards something other than going forward. Write its reward as na.gym.EpisodeRules."
        )
    is_ended = default_of(env_id, "terminate_when_unhealthy") is not None
    given: dict[str, Any] = {}
    if is_ended:
        given["healthy_reward"] = default_of(env_id, "healthy_reward")
        given["healthy_height"] = _limits(env_id, "healthy_z_range")
        given["healthy_angle"] = _limits(env_id, "healthy_angle_range")
    return TaskTable(
        environment=env_id,
        hold=default_of(env_id, "frame_skip"),
        forward_reward=default_of(env_id, "forward_reward_weight"),
        control_cost=default_of(env_id, "ctrl_cost_weight"),
        reset_noise=default_of(env_id, "reset_noise_scale"),
        **given,
    )


def definition_of(text: str) -> Definition | None:
    """Return the definition of a MuJoCo model in the JSON `text`; None for another system."""
    written = read_definition_text(text).definition if text else None
    return written if isinstance(written, Definition) else None


def task_of(definition: str, label: str) -> TaskTable:
    """Return the task of the system in the JSON text `definition`; ArgumentError, which names `label`, if there is none."""
    written = definition_of(definition)
    if written is not None and written.task is not None:
        return written.task
    raise ArgumentError(
        f"{label}: no [task]. 'neuroanimator new Hopper-v5' writes one for Gymnasium's environments that go forward; "
        "copy it and change its numbers, or write your own na.gym.EpisodeRules."
    )


def _limits(env_id: str, argument: str) -> tuple[float, float]:
    """Return the range of an environment's argument; infinite without one."""
    low, high = default_of(env_id, argument) or ANY
    return max(low, -FARTHEST), min(high, FARTHEST)


def locomotion_rules(
    task: TaskTable,
    structure: Structure,
    rest: Float[np.ndarray, " S"],
    parameters: Sequence[Parameter] = (),
) -> EpisodeRules:
    """Return the rules of `task` for a MuJoCo model whose first coordinates are its root's: x, z and pitch, or a free joint's.

    Episodes begin near `rest`, each with a body of the family that `parameters` describe. Rewards and endings take arrays
    of NumPy and JAX.
    """
    is_free = any(entry == FREE_ROOT - 4 for entry, _ in structure.orientations)
    height_entry = 2 if is_free else 1
    angle_entry = 2

    def is_healthy(states: Float[AnyArray, "... S"]) -> Bool[AnyArray, " ..."]:
        height = states[..., height_entry]
        low, high = task.healthy_height
        healthy = (height > low) & (height < high)
        if not is_free:
            low, high = task.healthy_angle
            angle = states[..., angle_entry]
            healthy = healthy & (angle > low) & (angle < high)
        return healthy

    def reward(
        states: Float[AnyArray, "... S"],
        controls: Float[AnyArray, "... C"],
        following: Float[AnyArray, "... S"],
        dt: float,
    ) -> Float[AnyArray, " ..."]:
        forward = (following[..., 0] - states[..., 0]) / dt
        effort = (controls**2).sum(axis=-1)
        return (
            task.forward_reward * forward
            - task.control_cost * effort
            + task.healthy_reward * is_healthy(following)
        )

    def is_over(states: Float[AnyArray, "... S"]) -> Bool[AnyArray, " ..."]:
        return ~is_healthy(states)

    def draw_start(rng: np.random.Generator) -> Float[np.ndarray, " S"]:
        start = np.array(rest, float)
        moving = len(start) - len(parameters)
        start[:moving] += rng.uniform(-task.reset_noise, task.reset_noise, moving)
        if parameters:
            start[moving:] = draw_parameters(parameters, rng, 1)[0]
        if is_free:
            start[3:FREE_ROOT] /= np.linalg.norm(start[3:FREE_ROOT])
        return start

    return EpisodeRules(reward, is_over=is_over, draw_start=draw_start, steps=task.steps)
