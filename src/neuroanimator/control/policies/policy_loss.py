"""What a policy should do, as a loss over swims of many bodies at once on the emulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.control.policies.closed_loop import decide
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.steering import SteeringTarget, leftward, unit, upright
from neuroanimator.emulator.emulator import Emulator

NEARLY_AHEAD = 0.2
"""Half of the random courses lie within this share of all angles: most of a life is small corrections."""
STEEPEST = 1.05
"""[rad] Of random courses, up or down."""


@dataclass(frozen=True)
class LossWeights:
    """What being amiss costs."""

    speed: float = 1.5
    """Of the squared error, as a share of the highest speed."""
    heading: float = 5.0
    """Of the squared distance between unit vectors: 1 at 60 degrees off course, pitch counting like yaw. With a fifth
    of it, beside a speed that weighs 1, a fish told to swim straight on at nine tenths of its speed was 18 degrees off
    after three seconds on the true physics: it rather hurried."""
    roll: float = 1.0
    """The same between up and where a body's back points. With a third of it, fish that keep turning or hurry lie on
    their sides."""
    effort: float = 0.02
    """Of the squared share of full effort."""
    jumps: float = 0.06
    """Of the squared change from control to control. With 0.02, and half of the effort's weight, one fish was 7.3
    instead of 4.6 degrees off course on the true physics after a turn of 120 (medians of 64 starts, one seed)."""
    outside: float = 0.3
    """Of the squared standard deviations outside of what the emulator was trained on: there it may be wrong, and
    descents like to go there."""


class Swimmers(NamedTuple):
    """Bodies on their way, each as its emulator sees it."""

    latent: Float[Array, "B I"]
    phase: Float[Array, " B"]
    """[rad] Of the clock."""
    course: SteeringTarget


def begin(policy: Policy, latent: Float[Array, "B I"], key: Array) -> Swimmers:
    """Return the bodies, each with its clock at random and a random course."""
    first, second = jax.random.split(key)
    phase = jax.random.uniform(first, latent.shape[:1], maxval=2 * jnp.pi)
    return Swimmers(latent, phase, random_courses(policy, latent, second))


def random_courses(policy: Policy, latent: Float[Array, "B I"], key: Array) -> SteeringTarget:
    """Return a random speed and direction for each: half of them nearly ahead, half anywhere."""
    keys, pose, count = jax.random.split(key, 4), policy.pose(latent), latent.shape[0]
    wide = jnp.where(jax.random.bernoulli(keys[0], 0.5, (count,)), 1.0, NEARLY_AHEAD)
    aside = wide * jax.random.uniform(keys[1], (count,), minval=-jnp.pi, maxval=jnp.pi)
    above = wide * jax.random.uniform(keys[2], (count,), minval=-STEEPEST, maxval=STEEPEST)
    level = jnp.cos(aside)[:, None] * pose.forward + jnp.sin(aside)[:, None] * leftward(pose)
    direction = jnp.cos(above)[:, None] * level + jnp.sin(above)[:, None] * upright(pose)
    top = policy.ranges.high[0]
    return SteeringTarget(unit(direction), jax.random.uniform(keys[3], (count,), maxval=top))


def swim(policy: Policy, swimmers: Swimmers, steps: int) -> tuple[Swimmers, Array, Array]:
    """Return the bodies after so many super steps, their inner states (T, B, I) on the way and controls (T, B, C)."""
    emulator = policy.emulator

    def advance(
        state: tuple[Array, Array], _: None
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        latent, phase = state
        controls = decide(policy, latent, phase, swimmers.course)
        following = jax.vmap(emulator.advance)(latent, emulator.encode_control(controls))
        return (following, phase + policy.tick), (following, controls)

    (latent, phase), (path, controls) = jax.lax.scan(
        advance, (swimmers.latent, swimmers.phase), length=steps
    )
    return Swimmers(latent, phase % (2 * jnp.pi), swimmers.course), path, controls


def motion_loss(
    weights: LossWeights, policy: Policy, swimmers: Swimmers, path: Array, controls: Array
) -> Array:
    """Return what is amiss in `path` (T, B, I) under `controls` (T, B, C), on average.

    Speed and heading are means over whole periods of the clock, since a swimming body sways.
    """
    pose, course, top = policy.pose(path), swimmers.course, policy.ranges.high[0]
    period = min(max(1, round(policy.rhythm.period / policy.dt)), len(path))
    pointing, upward = (unit(_moving_mean(axis, period)) for axis in (pose.forward, pose.upward))
    speed = _moving_mean(jnp.sum(pose.velocity * pose.forward, axis=-1, keepdims=True), period)[
        ..., 0
    ]
    level = unit(jnp.array([0.0, 0.0, 1.0]) - pointing[..., 2:] * pointing)
    control_scale = jnp.asarray(policy.emulator.spec.bounds.magnitude, jnp.float32)

    def square(vectors):
        return jnp.mean(jnp.sum(vectors**2, axis=-1))

    return (
        weights.speed * jnp.mean(((speed - course.speed) / top) ** 2)
        + weights.heading * square(pointing - course.direction)
        + weights.roll * square(upward - level)
        + weights.effort * jnp.mean((controls / control_scale) ** 2)
        + weights.jumps * jnp.mean((jnp.diff(controls, axis=0) / control_scale) ** 2)
        + weights.outside * jnp.mean(beyond(policy.emulator, path, controls) ** 2)
    )


def _moving_mean(rows: Float[Array, "T B A"], period: int) -> Float[Array, "T-period+1 B A"]:
    total = jnp.cumsum(jnp.concatenate([jnp.zeros_like(rows[:1]), rows]), axis=0)
    return (total[period:] - total[:-period]) / period


def beyond(
    emulator: Emulator, path: Float[Array, "T B I"], controls: Float[Array, "T B C"]
) -> Array:
    """Return (T, B, K) how far what the emulator sees lies outside of what training showed, in standard deviations."""
    plain, domain = emulator.seen(path, emulator.encode_control(controls)), emulator.domain
    return (plain - jax.vmap(jax.vmap(domain.clip))(plain)) / emulator.normaliser.plain_scale
