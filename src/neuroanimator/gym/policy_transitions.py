"""A policy's motions on the physics, as transitions that an emulator learns from.

Bodies follow the policy and are disturbed as in its task: new commands, pushes. Each adds its own amount of noise to the
policy's controls, from none to several times that of learning, so that an emulator covers the neighbourhood of a motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.gym.bodies import Bodies, roll_out
from neuroanimator.gym.policy_task import PolicyTask
from neuroanimator.gym.rules import unpaid
from neuroanimator.gym.state_rows import physics_stepper
from neuroanimator.learn.data.config import USUAL_SAMPLES_PER_RUN, DatasetConfig
from neuroanimator.learn.data.store import Transitions
from neuroanimator.systems.system import System

COUNT = 1_000_000
"""Default number of transitions."""

TRAINING: dict[str, Any] = {
    "network": "linear-glu",
    "widths": (128, 112),
    "updates": 30_000,
    "calm": 0.01,
}
"""Default settings of training on them: around a motion much is nearly linear, and training begins with that."""

BODIES = 200
"""Number of bodies side by side, each a run of the data."""

NOISE = (0.0, 0.5, 1.0, 2.0, 3.0)
"""Standard deviations of the noise, over that at the beginning of the policy's learning: a fifth of the bodies each."""

HELD_SHARE = 0.5
"""Probability that the noise of a control stays that of the step before."""


def policy_transitions(
    policy: StatePolicy,
    task: PolicyTask,
    system: System,
    *,
    count: int = COUNT,
    seed: int = 0,
    on_share: Callable[[float], None] = lambda share: None,
) -> Transitions:
    """Return windows of `count` transitions of bodies that `policy` moves on the physics, those with a disturbance left out.

    They follow from the arguments alone. `on_share` is called with the share done.
    """
    rng = np.random.default_rng(seed)
    rules = replace(task.rules, reward=unpaid)
    stepper = physics_stepper(system, system.scheme, policy.dt)
    bodies = Bodies(stepper, rules, policy.emulator, rng, BODIES)
    steps = -(-count // BODIES)
    levels = task.learning.spread * np.resize(NOISE, (BODIES, 1))

    def noises() -> Iterator[Float[np.ndarray, "N C"]]:
        noise = np.zeros((BODIES, policy.emulator.control.size))
        for step in range(steps):
            drawn = rng.normal(size=noise.shape)
            noise = np.where(rng.random((BODIES, 1)) < HELD_SHARE, noise, drawn)
            yield (levels * noise).astype(np.float32)
            on_share((step + 1) / steps)

    rollouts = roll_out(policy, bodies, noises(), rng)
    following = np.asarray(rollouts.following)
    states = np.concatenate([rollouts.states, following[-1:]])
    goes_on = (states[1:] == following).all(axis=2)
    controls = policy.emulator.bounds.clip(np.asarray(rollouts.controls)).astype(np.float32)
    config = DatasetConfig(
        system=system.name,
        definition=system.definition_text,
        substeps=task.hold,
        count=count,
        samples_per_run=USUAL_SAMPLES_PER_RUN,
        seed=seed,
    )
    return _windows(config, system, states, controls, goes_on)


def _windows(
    config: DatasetConfig,
    system: System,
    states: Float[np.ndarray, "K N S"],
    controls: Float[np.ndarray, "T N C"],
    goes_on: Bool[np.ndarray, "T N"],
) -> Transitions:
    """Return all windows in which each step continues the one before (`goes_on`)."""
    length = system.window_steps
    firsts = len(goes_on) - length + 1
    is_whole = np.ones((firsts, goes_on.shape[1]), bool)
    for step in range(length):
        is_whole &= goes_on[step : step + firsts]
    first, body = np.nonzero(is_whole)
    steps = first[:, None] + np.arange(length + 1)
    return Transitions(
        config=config,
        system=system,
        states=states[steps, body[:, None]],
        controls=controls[steps[:, :-1], body[:, None]],
        run=body,
        diverged=0,
    )
