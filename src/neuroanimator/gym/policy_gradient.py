"""Slopes of returns: rollouts on the true physics, their derivatives from an emulator, a critic beyond the horizon.

states, actions and following states of the physics  →  s′ = s′(physics) + f(s, u) − [f(s, u)], with [·] held constant
→  rewards on the way and the critic's value at the end  →  their derivative by the policy's weights
So returns are true, and only how they change is the emulator's.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import Network
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.gym.state_policy import Perceptron, StatePolicy, View
from neuroanimator.training.loss import unrolled_loss


class Rollouts(NamedTuple):
    """T steps of N bodies."""

    states: Float[Array, "T N S"]
    noise: Float[Array, "T N C"]
    """Noise of the policy."""
    controls: Float[Array, "T N C"]
    following: Float[Array, "T N S"]
    is_fallen: Bool[Array, "T N"]
    """Where the rules ended the episode: nothing is earned beyond."""
    is_last: Bool[Array, "T N"]
    """Where the episode ended, by the rules or by its length."""


def with_network(policy: StatePolicy, network: Perceptron) -> StatePolicy:
    """Return the policy with other weights."""
    return eqx.tree_at(lambda policy: policy.network, policy, network)


@eqx.filter_jit
def noisy_controls(
    policy: StatePolicy, states: Float[Array, "N S"], noise: Float[Array, "N C"]
) -> Float[Array, "N C"]:
    """Return the controls of the policy for bodies in `states`."""
    return policy.control_of(states, noise)


@eqx.filter_jit
def policy_gradient(
    policy: StatePolicy,
    critic: Perceptron,
    emulator: Emulator,
    rules: EpisodeRules,
    rollouts: Rollouts,
    discount: float,
) -> tuple[Float[Array, ""], Perceptron]:
    """Return minus the mean discounted return of a step, and its derivative by the weights of the policy."""
    length = len(rollouts.states)
    reward: Any = rules.reward

    def loss_of(network: Perceptron) -> Float[Array, ""]:
        trained = with_network(policy, network)

        def advance(carry: tuple, step: tuple) -> tuple[tuple, None]:
            carried, weight, total = carry
            moment, is_end = step
            states = _as(carried, moment.states)
            controls = trained.control_of(states, moment.noise)
            emulated = jax.vmap(emulator.step)(states, controls)
            following = _as(emulated, moment.following)
            rewards = reward(states, controls, following, policy.dt)
            beyond = critic(policy.view(following))[..., 0]
            beyond = jnp.where(moment.is_fallen, 0.0, beyond)
            ends = moment.is_last | is_end
            total += (weight * (rewards + jnp.where(ends, discount * beyond, 0.0))).sum()
            weight = jnp.where(moment.is_last, 1.0, discount * weight)
            is_cut = moment.is_last[:, None]
            following = jnp.where(is_cut, jax.lax.stop_gradient(following), following)
            return (following, weight, total), None

        start = (rollouts.states[0], jnp.ones(rollouts.states.shape[1]), jnp.zeros(()))
        is_end = jnp.arange(length) == length - 1
        (_, _, total), _ = jax.lax.scan(advance, start, (rollouts, is_end))
        return -total / rollouts.is_last.size

    return jax.value_and_grad(loss_of)(policy.network)


def _as(derived: Array, values: Array) -> Array:
    """Return `values` with the derivatives of `derived`."""
    return values + derived - jax.lax.stop_gradient(derived)


@eqx.filter_jit
def critic_targets(
    critic: Perceptron,
    view: View,
    rules: EpisodeRules,
    rollouts: Rollouts,
    discount: float,
    trace: float,
    dt: float,
) -> Float[Array, "T N"]:
    """Return the returns that a critic is fitted to: TD(λ), λ being `trace`."""
    beyond = critic(view(rollouts.following))[..., 0]
    beyond = jnp.where(rollouts.is_fallen, 0.0, beyond)
    reward: Any = rules.reward
    rewards = reward(rollouts.states, rollouts.controls, rollouts.following, dt)

    def back(later: Array, step: tuple) -> tuple[Array, Array]:
        reward, value, is_last = step
        mixed = (1 - trace) * value + trace * later
        target = reward + discount * jnp.where(is_last, value, mixed)
        return target, target

    _, targets = jax.lax.scan(back, beyond[-1], (rewards, beyond, rollouts.is_last), reverse=True)
    return targets


def critic_loss(
    critic: Perceptron, shown: Float[Array, "B O"], targets: Float[Array, " B"]
) -> Float[Array, ""]:
    """Return the mean squared error of the values."""
    return ((critic(shown)[..., 0] - targets) ** 2).mean()


def emulator_loss(
    network: Network,
    emulator: Emulator,
    states: Float[Array, "B S"],
    controls: Float[Array, "B C"],
    following: Float[Array, "B S"],
) -> Float[Array, ""]:
    """Return the squared error of the super steps of an emulator with this network."""
    emulator = eqx.tree_at(lambda emulator: emulator.network, emulator, network)
    windows = jnp.stack([emulator.encode(states), emulator.encode(following)], axis=1)
    driven = emulator.encode_control(controls)[:, None]
    return unrolled_loss(emulator, windows, driven)
