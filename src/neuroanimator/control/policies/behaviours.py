"""What a body wants from moment to moment: small functions from poses to urges, and from these to a course.

An urge (B, 3) is a vector in the world for each of B bodies: where to go, and how much it matters.
Urges are added up (Reynolds, Flocks, herds, and schools, SIGGRAPH 87).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.control.policies.steering import SteeringTarget, leftward, unit, upright
from neuroanimator.state.pose import Pose

WANDERING = ((0.37, 1.0), (0.83, 0.5))
"""[rad/s] and height of the slow waves that make up a stroll."""


GIVING_WAY = 0.1
"""How far to the side two bodies that would meet exactly are taken to pass, over their spacing."""
SLOWING = 0.7
"""Share of its speed a body gives up for one it is about to touch."""
STRAIGHT_ON = 0.1
"""Of an urge of one: decides where to go when the urge itself is straight up or down."""
SPACING = 2.0
"""Body lengths within which a shoal's bodies mind each other; a fish turns within about two."""
PUSHING, WALL = 12.0, 4.0
"""Of distance and of glass in a shoal: together they come before anything else from a length of one on. With half as
much pushing, twelve fish of a school touched in 2 to 6 % of the time at the glass."""

Behaviour = Callable[[Pose, Array], SteeringTarget]
"""(poses of B bodies, time [s]) → where each wants to go now."""


class Tank(NamedTuple):
    """A box that bodies stay in."""

    low: tuple[float, float, float]
    """[m]"""
    high: tuple[float, float, float]
    """[m]"""


def wander(pose: Pose, time: Array, *, width: float = 0.8, seed: int = 0) -> Float[Array, "B 3"]:
    """Return the urge to stroll at `time` [s]: up to about `width` [rad] aside, half of that up or down."""
    keys, sway = (
        jax.random.split(jax.random.key(seed), len(WANDERING)),
        jnp.zeros((2, pose.position.shape[0])),
    )
    for (rate, height), key in zip(WANDERING, keys, strict=True):
        sway += (
            width
            * height
            * jnp.sin(rate * time + jax.random.uniform(key, sway.shape, maxval=2 * jnp.pi))
        )
    aside, above = jnp.tan(sway[0] / 2), jnp.tan(sway[1] / 4)
    return unit(pose.forward + aside[:, None] * leftward(pose) + above[:, None] * upright(pose))


def pursue(pose: Pose, targets: ArrayLike) -> Float[Array, "B 3"]:
    """Return the urge toward `targets` (3,) or (B, 3) [m]."""
    return unit(jnp.asarray(targets) - pose.position)


def avoid(pose: Pose, positions: ArrayLike, reach: float) -> Float[Array, "B 3"]:
    """Return the urge away from `positions` (K, 3) [m] nearer than `reach` [m]: none there, one at the place itself."""
    apart = pose.position[:, None] - jnp.asarray(positions)
    return _pushed(apart, reach).sum(axis=1)


def stay_inside(
    pose: Pose, tank: Tank, margin: float, *, ahead: float = 2.0
) -> Float[Array, "B 3"]:
    """Return the urge inward: none further than `margin` [m] from the walls, one at a wall.

    What counts is where the body will be `ahead` [s] from now, since it cannot turn at once.
    """
    position = pose.position + ahead * pose.velocity
    low, high = (jnp.asarray(side) for side in tank)
    return (
        jnp.maximum(low + margin - position, 0) - jnp.maximum(position - (high - margin), 0)
    ) / margin


def school(pose: Pose, *, spacing: float, reach: float) -> Float[Array, "B 3"]:
    """Return the urge to swim with those nearer than `reach` [m]: as they do, toward them, at least `spacing` apart."""
    apart = pose.position[:, None] - pose.position[None]
    others = ~jnp.eye(len(pose.position), dtype=bool)
    near = jnp.exp(-jnp.sum((apart / reach) ** 2, axis=-1)) * others
    shares = near / (near.sum(axis=1, keepdims=True) + jnp.finfo(near.dtype).tiny)
    along, toward = shares @ pose.forward, -jnp.sum(shares[..., None] * apart, axis=1) / reach
    away = jnp.sum(_pushed(apart, spacing) * others[..., None], axis=1)
    return along + toward + 2 * away


def keep_apart(pose: Pose, spacing: float, *, ahead: float = 3.0) -> Float[Array, "B 3"]:
    """Return the urge away from others: none while nobody comes nearer than `spacing` [m] in `ahead` [s], one at touch.

    What counts is how near two bodies come if both go on as they do: a body that cannot turn at once must begin early.
    Two that would meet exactly give way to the same side, each to its left.
    """
    gap, nearness = _meetings(pose, spacing, ahead)
    away = gap + GIVING_WAY * spacing * leftward(pose)[:, None]
    return jnp.sum(unit(away) * nearness[..., None], axis=1)


def give_way(pose: Pose, spacing: float, *, ahead: float = 3.0) -> Float[Array, " B"]:
    """Return the share of its speed that each body should keep, for those in front of it: 1 if there are none."""
    _, nearness = _meetings(pose, spacing, ahead)
    toward = unit(pose.position[None] - pose.position[:, None])
    in_front = jnp.maximum(jnp.sum(toward * pose.forward[:, None], axis=-1), 0)
    return 1 - SLOWING * jnp.max(in_front * nearness, axis=1)


def first(urgent: Float[Array, "B 3"], other: Float[Array, "B 3"]) -> Float[Array, "B 3"]:
    """Return `urgent` before anything else: all of it where its length is one, `other` where it is none."""
    length = jnp.sqrt(jnp.sum(urgent**2, axis=-1, keepdims=True) + jnp.finfo(urgent.dtype).tiny)
    share = jnp.clip(length, 0, 1)
    return share * urgent / length + (1 - share) * unit(other)


def ease(
    urge: Float[Array, "B 3"], pose: Pose, *, steepest: float = 0.35, sharpest: float = 0.8
) -> Float[Array, "B 3"]:
    """Return `urge` made easy to follow: no steeper than `steepest`, no more than `sharpest` [rad] off the heading.

    A body asked to go back the way it came rolls on its side to do it; asked to turn for longer, it stays level.
    Where the urge is straight up or down, the body goes on as it points.
    """
    onward = urge + STRAIGHT_ON * pose.forward
    heading = jnp.arctan2(pose.forward[:, 1], pose.forward[:, 0])
    bend = (jnp.arctan2(onward[:, 1], onward[:, 0]) - heading + jnp.pi) % (2 * jnp.pi) - jnp.pi
    eased = heading + jnp.clip(bend, -sharpest, sharpest)
    flat = jnp.sqrt(jnp.sum(onward[:, :2] ** 2, axis=-1) + jnp.finfo(urge.dtype).tiny)
    climb = jnp.clip(urge[:, 2] / flat, -jnp.tan(steepest), jnp.tan(steepest))
    return unit(jnp.stack([jnp.cos(eased), jnp.sin(eased), climb], axis=-1))


def shoal(tank: Tank, *, length: float, speed: float, seed: int = 0) -> Behaviour:
    """Return the behaviour of bodies `length` [m] long that stroll together through `tank` at `speed` [m/s].

    Running into nobody, and into no glass, comes before company; nobody dives steeply.
    """

    def wish(pose: Pose, time: Array) -> SteeringTarget:
        company = wander(pose, time, seed=seed) + school(
            pose, spacing=1.5 * length, reach=3.0 * length
        )
        inward = WALL * stay_inside(pose, tank, margin=1.5 * length)
        apart = PUSHING * keep_apart(pose, SPACING * length)
        return follow(
            ease(first(apart + inward, company), pose), speed * give_way(pose, SPACING * length)
        )

    return wish


def follow(urge: Float[Array, "B 3"], speed: ArrayLike) -> SteeringTarget:
    """Return the course along `urge` at `speed` (B,) or one for all [m/s]."""
    return SteeringTarget(unit(urge), jnp.zeros_like(urge[:, 0]) + jnp.asarray(speed, urge.dtype))


def _meetings(
    pose: Pose, spacing: float, ahead: float
) -> tuple[Float[Array, "B B 3"], Float[Array, "B B"]]:
    """Return from where (B, B, 3) [m] each body is at its nearest to each other, and how near that is: 1 at touch.

    Meetings far in the future count less.
    """
    apart = pose.position[:, None] - pose.position[None]
    drift = pose.velocity[:, None] - pose.velocity[None]
    closing = -jnp.sum(apart * drift, axis=-1) / (
        jnp.sum(drift**2, axis=-1) + jnp.finfo(apart.dtype).eps
    )
    when = jnp.clip(closing, 0, ahead)
    gap = apart + when[..., None] * drift
    distance = jnp.sqrt(jnp.sum(gap**2, axis=-1) + jnp.finfo(apart.dtype).tiny)
    others = ~jnp.eye(len(pose.position), dtype=bool)
    return gap, jnp.maximum(1 - distance / spacing, 0) / (1 + when / ahead) * others


def _pushed(apart: Float[Array, "B K 3"], reach: float) -> Float[Array, "B K 3"]:
    distance = jnp.sqrt(jnp.sum(apart**2, axis=-1, keepdims=True) + jnp.finfo(apart.dtype).tiny)
    return apart / distance * jnp.maximum(1 - distance / reach, 0)
