"""The terms of policy learning: advantages and gradients of actions, and the loss of a policy.

states, actions and following states of the physics
→  values of a critic and rewards  →  how much more each action earned than expected (advantages, true)
→  backwards: the value's gradient at s′, the critic's mixed with later ones  →  by the action (gradients, the emulator's)
→  two estimates of the policy gradient: by likelihoods, unbiased and noisy; by the emulator, less noisy but biased
→  their mean with the least expected error
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from neuroanimator.control.policies.state_policy import Perceptron, StatePolicy, View
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import Network
from neuroanimator.gym.bodies import Rollouts
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.learn.training.loss import unrolled_loss

CLIP = 0.2
"""Change of an action's likelihood ratio at which it is clipped."""


class Critic(eqx.Module):
    """The value of states, from their features."""

    network: Perceptron
    unit: Float[Array, ""]
    """Unit of the network's output."""

    def __call__(self, observations: Float[Array, "*B O"]) -> Float[Array, " *B"]:
        return self.unit * self.network(observations)[..., 0]


@eqx.filter_jit
def action_gradients(
    policy: StatePolicy,
    critic: Critic,
    rules: EpisodeRules,
    rollouts: Rollouts,
    discount: float,
    trace: float,
) -> Float[Array, "T N C"]:
    """Return the derivative of the value by the network's outputs, before they are squashed into bounds.

    It follows from the gradient of the value at the state that an action leads to: the critic's and later ones, mixed as
    values are by TD(λ) (value-gradient learning, Fairbank and Alonso 2012), λ being `trace`.
    """
    reward: Any = rules.reward

    def total_value(states: Float[Array, "T N S"]) -> Float[Array, ""]:
        return critic(policy.view(states)).sum()

    beyond = jax.grad(total_value)(rollouts.following)
    beyond = jnp.where(rollouts.is_fallen[..., None], 0.0, beyond)

    def back(later: Array, step: tuple) -> tuple[Array, Array]:
        moment, at_once = step
        mixed = (1 - trace) * at_once + trace * later
        gradient = jnp.where(moment.is_last[:, None], at_once, mixed)

        def value(states: Float[Array, "N S"], noise: Float[Array, "N C"]) -> Float[Array, ""]:
            controls = policy.control_of(states, noise)
            following = _as(jax.vmap(policy.emulator.step)(states, controls), moment.following)
            rewards = reward(states, controls, following, policy.dt)
            return rewards.sum() + discount * (gradient * following).sum()

        return jax.grad(value, argnums=(0, 1))(moment.states, moment.noise)

    _, gradients = jax.lax.scan(back, beyond[-1], (rollouts, beyond), reverse=True)
    return gradients


def _as(derived: Array, values: Array) -> Array:
    """Return `values` with the derivatives of `derived`."""
    return values + derived - jax.lax.stop_gradient(derived)


@eqx.filter_jit
def advantages(
    critic: Critic,
    view: View,
    rules: EpisodeRules,
    rollouts: Rollouts,
    discount: float,
    trace: float,
    dt: float,
) -> Float[Array, "T N"]:
    """Return the advantage of each action over its state's value: by TD(λ), λ being `trace`."""
    beyond = jnp.where(rollouts.is_fallen, 0.0, critic(view(rollouts.following)))
    reward: Any = rules.reward
    rewards = reward(rollouts.states, rollouts.controls, rollouts.following, dt)
    at_once = rewards + discount * beyond - critic(view(rollouts.states))

    def back(later: Array, step: tuple) -> tuple[Array, Array]:
        earned, is_last = step
        total = earned + discount * trace * jnp.where(is_last, 0.0, later)
        return total, total

    start = jnp.zeros(at_once.shape[1])
    _, found = jax.lax.scan(back, start, (at_once, rollouts.is_last), reverse=True)
    return found


class Minibatch(NamedTuple):
    """Training data of a policy: B actions."""

    observations: Float[Array, "B O"]
    noise: Float[Array, "B C"]
    means: Float[Array, "B C"]
    """Outputs of the network, without the noise."""
    advantages: Float[Array, " B"]
    gradients: Float[Array, "B C"]


class Actor(eqx.Module):
    """Normally distributed outputs."""

    network: Perceptron
    log_spread: Float[Array, " C"]
    """Logarithm of their standard deviation."""


def policy_loss(
    actor: Actor, before: Float[Array, " C"], weight: Float[Array, ""], batch: Minibatch
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return (minus the mean gain over the policy that acted, the divergence from it); `before` is its log spread.

    Advantages count by the clipped ratio of likelihoods (proximal policy optimisation, Schulman and others 2017); gradients,
    times `weight`, by the change of the means.
    """
    moved = actor.network(batch.observations) - batch.means
    was = batch.noise / jnp.exp(before)
    # Likelihoods count by the rest of the weight for means; in full for the spread, which the emulator says nothing of.
    by_likelihoods = moved - weight * (moved - jax.lax.stop_gradient(moved))
    is_now = (batch.noise - by_likelihoods) / jnp.exp(actor.log_spread)
    log_ratio = ((was**2 - is_now**2) / 2 + before - actor.log_spread).sum(axis=-1)
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - CLIP, 1 + CLIP)
    gained = jnp.minimum(ratio * batch.advantages, clipped * batch.advantages)
    gained += weight * (batch.gradients * moved).sum(axis=-1)
    variance = jnp.exp(2 * actor.log_spread)
    apart = actor.log_spread - before + (jnp.exp(2 * before) + moved**2) / (2 * variance) - 0.5
    return -gained.mean(), apart.sum(axis=-1).mean()


@eqx.filter_jit
def weight_of_gradients(actor: Actor, batch: Minibatch, groups: int) -> Float[Array, ""]:
    """Return the weight of the emulator's gradients, from 0 to 1, that minimises the expected squared error of the policy's.

    The gradient by likelihoods is unbiased; its variance, and the covariance of the two, are those between `groups` of
    actions (Suh and others, *Do differentiable simulators give better policy gradients?*, 2022).
    """

    def gradient(weight: float, part: Minibatch) -> Float[Array, " W"]:
        def loss(network: Perceptron) -> Float[Array, ""]:
            moved = Actor(network, actor.log_spread)
            return policy_loss(moved, actor.log_spread, jnp.asarray(weight), part)[0]

        return ravel_pytree(jax.grad(loss)(actor.network))[0]

    parts = jax.tree.map(lambda part: part.reshape(groups, -1, *part.shape[1:]), batch)
    by_likelihoods = jax.vmap(lambda part: gradient(0.0, part))(parts)
    by_emulator = jax.vmap(lambda part: gradient(1.0, part))(parts)
    apart = ((by_likelihoods - by_emulator).mean(axis=0) ** 2).sum()
    by_likelihoods -= by_likelihoods.mean(axis=0)
    by_emulator -= by_emulator.mean(axis=0)
    excess = (by_likelihoods * (by_likelihoods - by_emulator)).sum() / (groups * (groups - 1))
    weight = jnp.clip(excess / apart, 0, 1)
    return jnp.where(jnp.isfinite(weight), weight, 0.0)


def critic_loss(
    network: Perceptron, observations: Float[Array, "B O"], targets: Float[Array, " B"]
) -> Float[Array, ""]:
    """Return the mean squared error of values, in the critic's own unit."""
    return ((network(observations)[..., 0] - targets) ** 2).mean()


def emulator_loss(
    emulator: Emulator,
    network: Network,
    states: Float[Array, "B S"],
    controls: Float[Array, "B C"],
    following: Float[Array, "B S"],
) -> Float[Array, ""]:
    """Return the squared error of the super steps of an emulator with this network."""
    emulator = eqx.tree_at(lambda emulator: emulator.network, emulator, network)
    windows = jnp.stack([emulator.encode(states), emulator.encode(following)], axis=1)
    driven = emulator.encode_control(controls)[:, None]
    return unrolled_loss(emulator, windows, driven)
