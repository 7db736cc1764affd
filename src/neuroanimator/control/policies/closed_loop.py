"""Closed-loop rollouts: a policy drives many bodies at once, on the true physics or on its emulator."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.control.policies.behaviours import Behaviour
from neuroanimator.control.policies.policy import Policy, latent_structure
from neuroanimator.control.policies.steering import SteeringTarget, command_toward
from neuroanimator.control.policies.super_step import make_super_step
from neuroanimator.emulator.arrays import as_float32, as_jax
from neuroanimator.emulator.super_step import locate
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.pose import read_pose
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import Runs, System


def choose_controls(
    policy: Policy,
    latent: Float[Array, "B I"],
    phase: Float[Array, " B"],
    target: SteeringTarget,
) -> Float[Array, "B C"]:
    """Return the controls of bodies in the states `latent` at `phase` [rad] of their clocks.

    Unchecked: for use inside jit.
    """
    command = command_toward(target, policy.pose(latent))
    return jax.vmap(policy.control)(latent, phase, command)


def rollout_on_emulator(
    policy: Policy,
    behaviour: Behaviour,
    starts: ArrayLike,
    steps: int,
    *,
    seed: int = 0,
) -> Float[Array, "B {steps}+1 S"]:
    """Return the emulator's motions of bodies from `starts` (B, S), each of which always follows `behaviour`.

    Super steps are computed by the `backend`. Clocks begin at random, by `seed`, so that bodies are not synchronised.

    Raises ArgumentError for starts of another shape.
    """
    checked = policy.emulator.state.check(starts, "starts")
    if checked.ndim != 2 or steps < 1:
        raise ArgumentError(
            f"starts and steps: wanted (B, S) and at least 1, got {checked.shape} and {steps}."
        )
    structure = latent_structure(policy.emulator)
    axes = policy.emulator.origin
    phase = np.asarray(jax.random.uniform(jax.random.key(seed), (len(checked),), maxval=2 * jnp.pi))
    body = locate(policy.emulator, checked)
    path = [checked]
    for time in np.arange(steps, dtype=np.float32) * np.float32(policy.dt):
        in_world = as_float32(axes.latent.moved(body.latent, body.origin))
        wanted = _target(behaviour, structure, in_world, time)
        direction = np.broadcast_to(wanted.direction, (len(checked), 3))
        speed = np.broadcast_to(wanted.speed, (len(checked),))
        made = make_super_step(policy, body.latent, phase, SteeringTarget(direction, speed))
        body, states = body.moved_on(axes, made.latent, made.states)
        phase = ((phase + policy.tick) % (2 * np.pi)).astype(np.float32)
        path.append(states)
    return as_jax(np.stack(path, axis=1))


@eqx.filter_jit
def _target(
    behaviour: Behaviour,
    structure: Structure,
    latent: Float[AnyArray, "B I"],
    time: Float[AnyArray, ""],
) -> SteeringTarget:
    """Return the current target of each body; eqx.filter_jit flattens only the small part of a policy that this needs."""
    return behaviour(read_pose(structure, latent), time)


def rollout_on_physics(
    policy: Policy,
    system: System,
    starts: Float[np.ndarray, "B S"],
    target: SteeringTarget,
    steps: int,
) -> tuple[Runs, Float[np.ndarray, "B {steps} C"]]:
    """Return the motions of bodies from `starts` to `target` on the true physics, and their controls.

    A body whose physics diverged stays where it was.
    """
    states = [np.asarray(starts, float)]
    controls = []
    has_diverged = np.zeros(len(starts), bool)
    phase = np.zeros(len(starts))
    for _ in range(steps):
        latent = locate(policy.emulator, states[-1]).latent
        chosen = make_super_step(policy, latent, phase, target).controls
        held = system.bounds.clip(np.asarray(chosen, float))  # float32 may round beyond a bound
        runs = system.simulate_fastest(states[-1], held[:, None], policy.dt)
        has_diverged |= runs.has_diverged
        states.append(np.where(has_diverged[:, None], states[-1], runs.states[:, -1]))
        controls.append(held)
        phase = (phase + policy.tick) % (2 * np.pi)
    return Runs(np.stack(states, axis=1), has_diverged), np.stack(controls, axis=1)
