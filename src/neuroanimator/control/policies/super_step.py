"""A policy's super step: it observes a body, sets its muscles, and the emulator advances. In C if the `backend` is C."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.steering import SteeringTarget, command_toward, unit
from neuroanimator.emulator.c_rows import RowFunction
from neuroanimator.emulator.probes import probes_of
from neuroanimator.emulator.tensors import to_numpy
from neuroanimator.files.atomic import canonical_json, digest

EXCESS = 0.2
"""Share of a policy's range of speeds by which the samples of a program's check exceed it."""


class PolicyStep(NamedTuple):
    """Motion of bodies in a super step."""

    latent: Float[np.ndarray, "B I"]
    """Latent states at its end."""
    states: Float[np.ndarray, "B S"]
    """States at its end."""
    controls: Float[np.ndarray, "B C"]
    """Controls held on the way."""


def make_super_step(
    policy: Policy,
    latent: Float[np.ndarray, "B I"],
    phase: Float[np.ndarray, " B"],
    target: SteeringTarget,
) -> PolicyStep:
    """Return the super step of bodies in the states `latent`, at `phase` [rad] of their clocks, toward `target` (B)."""
    outputs = ROWS(
        policy,
        latent,
        np.asarray(phase)[:, None],
        np.asarray(target.direction),
        np.asarray(target.speed)[:, None],
    )
    return PolicyStep(*outputs)


def policy_super_step(
    policy: Policy,
    latent: Float[Array, " I"],
    phase: Float[Array, " 1"],
    direction: Float[Array, " 3"],
    speed: Float[Array, " 1"],
) -> tuple[Float[Array, " I"], Float[Array, " S"], Float[Array, " C"]]:
    """Return (the latent state a super step later, the state, the controls held on the way) of one body."""
    emulator = policy.emulator
    command = command_toward(SteeringTarget(direction, speed[0]), policy.pose(latent))
    controls = policy.control(latent, phase[0], command)
    following = emulator.step_latent(latent, emulator.encode_control(controls))
    return following, emulator.decode(following), controls


def facts_of_policy(policy: Policy) -> list[str]:
    """Return the facts that determine what a policy computes, in words and numbers."""
    return [canonical_json(policy.describe()), digest(to_numpy(policy.leaves()))]


def _samples(policy: Policy) -> list[Float[np.ndarray, "N _"]]:
    """Return a thousand bodies, clocks and targets: some far outside of training."""
    rng = np.random.default_rng(0)
    states, _ = probes_of(policy.emulator).inputs
    count = len(states)
    directions = unit(rng.normal(size=(count, 3)))
    slowest, fastest = policy.ranges.low[0], policy.ranges.high[0]
    excess = EXCESS * (fastest - slowest)
    speeds = rng.uniform(slowest - excess, fastest + excess, (count, 1))
    phases = rng.uniform(0, 2 * np.pi, (count, 1))
    latent = policy.emulator.encode(states)
    return [latent, phases, directions, speeds]


ROWS = RowFunction(policy_super_step, facts_of_policy, _samples)
"""`policy_super_step` of many bodies."""
