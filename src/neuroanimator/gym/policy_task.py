"""The task of a policy, from its definition: go forward ([task]), or follow a recorded motion ([follow])."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from neuroanimator.control.policies.reference_motion import ReferenceMotion
from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.definitions.follow import FollowTable
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.following import following_rules
from neuroanimator.gym.learner import PolicyLearning
from neuroanimator.gym.locomotion import definition_of, locomotion_rules, task_of
from neuroanimator.gym.read_motion import read_motion
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.system import System

GOING = PolicyLearning()
"""Settings of learning to go forward."""

FOLLOWING = PolicyLearning(
    discount=0.97,
    gradient_weight=0.0,
    policy_widths=(256, 128),
    critic_widths=(256, 128),
    divergence=0.015,
    reports=12,
)
"""Settings of learning to follow a motion, except `spread`."""

EXPLORATION = 0.06
"""Initial standard deviation of the noise in servo targets [rad]."""


class FirstEmulator(NamedTuple):
    """Settings of the initial emulator."""

    transitions: int
    """Number of random transitions: later it learns from those of policies."""
    widths: tuple[int, ...]
    """Number of units in each layer."""
    updates: int


FOR_SLOPES = FirstEmulator(36_000, (192, 128), 1000)

FOR_NO_SLOPES = FirstEmulator(3_600, (32,), 250)
"""For learning by likelihoods alone: a policy's file has an emulator, which describes states and controls but is not run."""


class PolicyTask(NamedTuple):
    """A task of either table."""

    rules: EpisodeRules
    hold: int
    """Number of physics steps for which a control is held."""
    steps: int
    """Maximum number of controls in an episode."""
    learning: PolicyLearning
    """Settings of learning."""
    emulator: FirstEmulator = FOR_SLOPES
    environment: str = ""
    """Id of Gymnasium's environment in which policies are evaluated; empty for the physics."""
    motion: ReferenceMotion | None = None
    """The motion to follow, if any."""


def check_task(definition: str, label: str) -> None:
    """Raise ArgumentError, which names `label`, if the JSON text `definition` has no task."""
    if follow_table(definition) is None:
        task_of(definition, label)


def task_to_learn(definition: str, toml: Path, system: System) -> PolicyTask:
    """Return the task of the TOML file with the JSON text `definition`, whose motion, if any, lies beside it.

    ArgumentError if there is no task or it does not suit the system, BadFileError for an unsuitable motion.
    """
    table = follow_table(definition)
    if table is None:
        return _going(definition, str(toml), system)
    motion = read_motion(toml.parent / table.clip, table, system)
    return _following(table, motion, system)


def task_of_policy(policy: StatePolicy, path: Path, system: System) -> PolicyTask:
    """Return the task for which the policy in the file at `path` was learnt; the file holds the motion, if any."""
    definition = policy.emulator.definition
    table = follow_table(definition)
    motion = policy.view.reference
    if table is None or motion is None:
        return _going(definition, str(path), system)
    return _following(table, motion, system)


def follow_table(definition: str) -> FollowTable | None:
    """Return the table [follow] of a definition; None if there is none. ArgumentError if there is a [task], too."""
    written = definition_of(definition)
    if written is None or written.follow is None:
        return None
    if written.task is not None:
        raise ArgumentError("[task] and [follow]: a policy does one or the other. Remove one.")
    return written.follow


def _going(definition: str, label: str, system: System) -> PolicyTask:
    table = task_of(definition, label)
    rules = locomotion_rules(table, system.structure, system.rest, system.parameters)
    return PolicyTask(rules, table.hold, table.steps, GOING, environment=table.environment)


def _following(table: FollowTable, motion: ReferenceMotion, system: System) -> PolicyTask:
    if not isinstance(system, MujocoSystem):
        raise ArgumentError("follow: wanted a MuJoCo model.")
    rules = following_rules(table, motion, system)
    learning = replace(FOLLOWING, spread=EXPLORATION / table.reach)
    return PolicyTask(rules, table.hold, rules.steps or 1, learning, FOR_NO_SLOPES, motion=motion)
