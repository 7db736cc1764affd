"""What a body wants from moment to moment: small functions from poses to urges, and from these to a course.

An urge (B, 3) is a vector in the world for each of B bodies: where to go, and how much it matters.
Urges are added up (Reynolds, Flocks, herds, and schools, SIGGRAPH 87).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.control.policies.course import Course, leftward, unit, upright
from neuroanimator.control.pose import Pose

WANDERING = ((0.37, 1.0), (0.83, 0.5))
"""[rad/s] and height of the slow waves that make up a stroll."""


class Tank(NamedTuple):
    """A box that bodies stay in."""

    low: tuple[float, float, float]
    """[m]"""
    high: tuple[float, float, float]
    """[m]"""


def wander(pose: Pose, time: Array, *, width: float = 0.8, seed: int = 0) -> Float[Array, "B 3"]:
    """Return the urge to stroll at `time` [s]: up to about `width` [rad] aside, half of that up or down."""
    keys, sway = jax.random.split(jax.random.key(seed), len(WANDERING)), jnp.zeros((2, pose.place.shape[0]))
    for (rate, height), key in zip(WANDERING, keys, strict=True):
        sway += width * height * jnp.sin(rate * time + jax.random.uniform(key, sway.shape, maxval=2 * jnp.pi))
    aside, above = jnp.tan(sway[0] / 2), jnp.tan(sway[1] / 4)
    return unit(pose.forward + aside[:, None] * leftward(pose) + above[:, None] * upright(pose))


def pursue(pose: Pose, targets: ArrayLike) -> Float[Array, "B 3"]:
    """Return the urge toward `targets` (3,) or (B, 3) [m]."""
    return unit(jnp.asarray(targets) - pose.place)


def avoid(pose: Pose, places: ArrayLike, reach: float) -> Float[Array, "B 3"]:
    """Return the urge away from `places` (K, 3) [m] nearer than `reach` [m]: none there, one at the place itself."""
    apart = pose.place[:, None] - jnp.asarray(places)
    return _pushed(apart, reach).sum(axis=1)


def stay_inside(pose: Pose, tank: Tank, margin: float, *, ahead: float = 2.0) -> Float[Array, "B 3"]:
    """Return the urge inward: none further than `margin` [m] from the walls, one at a wall.

    What counts is where the body will be `ahead` [s] from now, since it cannot turn at once.
    """
    place = pose.place + ahead * pose.velocity
    low, high = (jnp.asarray(side) for side in tank)
    return (jnp.maximum(low + margin - place, 0) - jnp.maximum(place - (high - margin), 0)) / margin


def school(pose: Pose, *, spacing: float, reach: float) -> Float[Array, "B 3"]:
    """Return the urge to swim with those nearer than `reach` [m]: as they do, toward them, at least `spacing` apart."""
    apart = pose.place[:, None] - pose.place[None]
    others = ~jnp.eye(len(pose.place), dtype=bool)
    near = jnp.exp(-jnp.sum((apart / reach) ** 2, axis=-1)) * others
    shares = near / (near.sum(axis=1, keepdims=True) + jnp.finfo(near.dtype).tiny)
    along, toward = shares @ pose.forward, -jnp.sum(shares[..., None] * apart, axis=1) / reach
    away = jnp.sum(_pushed(apart, spacing) * others[..., None], axis=1)
    return along + toward + 2 * away


def follow(urge: Float[Array, "B 3"], speed: ArrayLike) -> Course:
    """Return the course along `urge` at `speed` (B,) or one for all [m/s]."""
    return Course(unit(urge), jnp.zeros_like(urge[:, 0]) + jnp.asarray(speed, urge.dtype))


def _pushed(apart: Float[Array, "B K 3"], reach: float) -> Float[Array, "B K 3"]:
    distance = jnp.sqrt(jnp.sum(apart**2, axis=-1, keepdims=True) + jnp.finfo(apart.dtype).tiny)
    return apart / distance * jnp.maximum(1 - distance / reach, 0)
