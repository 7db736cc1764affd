"""The loss of a policy in training: random targets, and rollouts of many bodies at once on the emulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.control.policies.closed_loop import choose_controls
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.steering import (
    SteeringTarget,
    leftward,
    rotated_toward,
    unit,
    upright,
)
from neuroanimator.emulator.emulator import Emulator

NEARLY_AHEAD = 0.2
"""Share of all angles that holds half of the random targets: most steering is small corrections."""

MAX_CLIMB = 1.05
"""Maximum elevation of random targets above or below the body [rad]."""


@dataclass(frozen=True)
class LossWeights:
    """Weights of the loss."""

    speed: float = 1.5
    """Weight of the squared error in speed, as a share of the maximum speed."""
    heading: float = 5.0
    """Weight of the squared distance between the unit vectors of the body and of its target.

    The distance is 1 at 60 degrees off course, with pitch counting like yaw. With a fifth of this weight, and 1 for speed,
    a fish commanded straight ahead at nine tenths of its speed was 18 degrees off after three seconds on the true
    physics: it put speed first.
    """
    roll: float = 1.0
    """Weight of the squared distance between up and the direction of a body's back.

    With a third of this weight, fish that turn for long or swim fast lie on their sides.
    """
    effort: float = 0.02
    """Weight of the squared controls, as shares of full effort."""
    jumps: float = 0.06
    """Weight of the squared changes from control to control, as shares of full effort.

    With 0.02, and half of the effort's weight, one fish was 7.3 instead of 4.6 degrees off course on the true physics
    after a turn of 120 (medians of 64 starts, one seed).
    """
    outside: float = 0.3
    """Weight of the squared standard deviations outside of the emulator's training.

    There it may be wrong, and descents tend to go there.
    """


class Swimmers(NamedTuple):
    """Bodies in motion, in the emulator's terms."""

    latent: Float[Array, "B I"]
    """Latent states."""
    phase: Float[Array, " B"]
    """Phases of their clocks [rad]."""
    target: SteeringTarget
    """Target of each."""


@eqx.filter_jit
def start_swimmers(policy: Policy, latent: Float[Array, "B I"], key: PRNGKeyArray) -> Swimmers:
    """Return bodies in the states `latent`, each with a random phase and a random target."""
    phase_key, target_key = jax.random.split(key)
    phase = jax.random.uniform(phase_key, latent.shape[:1], maxval=2 * jnp.pi)
    return Swimmers(latent, phase, random_targets(policy, latent, target_key))


def random_targets(
    policy: Policy, latent: Float[Array, "B I"], key: PRNGKeyArray
) -> SteeringTarget:
    """Return a random direction and speed for each body: half of them nearly ahead, half anywhere."""
    wide_key, aside_key, above_key, speed_key = jax.random.split(key, 4)
    pose = policy.pose(latent)
    shape = latent.shape[:1]
    is_anywhere = jax.random.bernoulli(wide_key, 0.5, shape)
    width = jnp.where(is_anywhere, 1.0, NEARLY_AHEAD)
    aside = width * jax.random.uniform(aside_key, shape, minval=-jnp.pi, maxval=jnp.pi)
    above = width * jax.random.uniform(above_key, shape, minval=-MAX_CLIMB, maxval=MAX_CLIMB)
    level = rotated_toward(leftward(pose), pose.forward, aside)
    direction = rotated_toward(upright(pose), level, above)
    speed = jax.random.uniform(speed_key, shape, maxval=policy.ranges.high[0])
    return SteeringTarget(unit(direction), speed)


def rollout_swimmers(
    policy: Policy, swimmers: Swimmers, steps: int
) -> tuple[Swimmers, Float[Array, "{steps} B I"], Float[Array, "{steps} B C"]]:
    """Return the bodies after `steps` super steps, their latent states on the way, and their controls."""
    emulator = policy.emulator

    def advance(
        carry: tuple[Array, Array], _: None
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        latent, phase = carry
        controls = choose_controls(policy, latent, phase, swimmers.target)
        following = jax.vmap(emulator.step_latent)(latent, emulator.encode_control(controls))
        return (following, phase + policy.tick), (following, controls)

    start = (swimmers.latent, swimmers.phase)
    (latent, phase), (path, controls) = jax.lax.scan(advance, start, length=steps)
    return Swimmers(latent, phase % (2 * jnp.pi), swimmers.target), path, controls


@eqx.filter_jit
def swim_loss(
    weights: LossWeights, policy: Policy, swimmers: Swimmers, steps: int
) -> tuple[Float[Array, ""], Swimmers]:
    """Return (the loss of `steps` super steps, on average over bodies and super steps, the bodies after them).

    Speed and heading are means over whole periods of the clock, since a swimming body sways.
    """
    following, path, controls = rollout_swimmers(policy, swimmers, steps)
    pose = policy.pose(path)
    target = swimmers.target
    top_speed = policy.ranges.high[0]
    period = min(max(1, round(policy.rhythm.period / policy.dt)), len(path))
    pointing = unit(_moving_mean(pose.forward, period))
    upward = unit(_moving_mean(pose.upward, period))
    speed_now = jnp.sum(pose.velocity * pose.forward, axis=-1, keepdims=True)
    speed = _moving_mean(speed_now, period)[..., 0]
    # The direction orthogonal to where the body points that is nearest to up.
    level = unit(jnp.array([0.0, 0.0, 1.0]) - pointing[..., 2:] * pointing)
    control_scale = jnp.asarray(policy.emulator.bounds.magnitude, jnp.float32)

    def mean_square(vectors: Array) -> Array:
        return jnp.mean(jnp.sum(vectors**2, axis=-1))

    loss = (
        weights.speed * jnp.mean(((speed - target.speed) / top_speed) ** 2)
        + weights.heading * mean_square(pointing - target.direction)
        + weights.roll * mean_square(upward - level)
        + weights.effort * jnp.mean((controls / control_scale) ** 2)
        + weights.jumps * jnp.mean((jnp.diff(controls, axis=0) / control_scale) ** 2)
        + weights.outside * jnp.mean(outside_training(policy.emulator, path, controls) ** 2)
    )
    return loss, following


def _moving_mean(rows: Float[Array, "T B A"], period: int) -> Float[Array, "T-{period}+1 B A"]:
    total = jnp.cumsum(jnp.concatenate([jnp.zeros_like(rows[:1]), rows]), axis=0)
    return (total[period:] - total[:-period]) / period


def outside_training(
    emulator: Emulator, path: Float[Array, "T B I"], controls: Float[Array, "T B C"]
) -> Float[Array, "T B K"]:
    """Return the distance of the emulator's features outside of their ranges in training, in standard deviations."""
    features = emulator.raw_features(path, emulator.encode_control(controls))
    inside = jax.vmap(jax.vmap(emulator.domain.clip))(features)
    return (features - inside) / emulator.normaliser.plain_scale
