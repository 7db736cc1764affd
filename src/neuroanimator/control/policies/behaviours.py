"""Behaviours: momentary steering forces of many bodies, and the targets that follow from them.

A steering force (B, 3) is a vector in the world for each of B bodies: the direction to go, and its
importance. Forces are summed (Reynolds, Flocks, herds, and schools, SIGGRAPH 87, and Steering behaviors for
autonomous characters, GDC 99).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Num
from numpy.typing import ArrayLike

from neuroanimator.control.policies.steering import (
    SteeringTarget,
    for_each,
    leftward,
    unit,
    upright,
)
from neuroanimator.state.pose import Pose


class Wave(NamedTuple):
    """One of the slow waves that add up to a stroll."""

    rate: float
    """Angular rate of its phase [rad/s]."""
    height: float
    """Amplitude, as a share of the stroll's width."""


WANDER_WAVES = (Wave(rate=0.37, height=1.0), Wave(rate=0.83, height=0.5))
"""Waves of a stroll: their rates have no simple ratio, so that it does not repeat itself soon."""

SCHOOL_SEPARATION = 2.0
"""Weight of separation in a school, relative to alignment and cohesion."""

PASSING_SIDE = 0.1
"""Assumed sideways distance at which two bodies on an exact collision course pass, as a share of their spacing."""

GIVEN_UP_SPEED = 0.7
"""Share of its speed that a body gives up to avoid touching another."""

STRAIGHT_ON = 0.1
"""Forward force, relative to a force of one: it decides the heading when the force itself is vertical."""

SHOAL_SPACING = 1.5
"""Spacing between the bodies of a shoal [body lengths]."""

SHOAL_REACH = 3.0
"""Distance within which the bodies of a shoal count as neighbours [body lengths]."""

SHOAL_MARGIN = 1.5
"""Distance from the glass within which a shoal's bodies turn inward [body lengths]."""

SHOAL_CLEARANCE = 2.0
"""Distance within which a shoal's bodies avoid meeting [body lengths]; a fish turns within about two."""

SHOAL_AVOIDANCE = 12.0
"""Weight of keeping apart in a shoal: with that of the glass, it has priority over anything else from a force of one on.

With half as much, twelve fish of a school touched in 2 to 6 % of the time at the glass.
"""

SHOAL_CONTAINMENT = 4.0
"""Weight of staying off the glass in a shoal."""

Behaviour = Callable[[Pose, Array], SteeringTarget]
"""A function of the poses of B bodies and the time [s] that returns the current target of each."""


class Tank(NamedTuple):
    """A box in which bodies stay."""

    low: tuple[float, float, float]
    """Corner with the smallest coordinates [m]."""
    high: tuple[float, float, float]
    """Corner with the largest coordinates [m]."""


def wander(
    pose: Pose, time: Num[Array, ""], *, width: float = 0.8, seed: int = 0
) -> Float[Array, "B 3"]:
    """Return the force of a stroll at `time` [s]: up to about `width` [rad] sideways, half of that up or down."""
    keys = jax.random.split(jax.random.key(seed), len(WANDER_WAVES))
    sway = jnp.zeros((2, pose.position.shape[0]))
    for wave, key in zip(WANDER_WAVES, keys, strict=True):
        begin = jax.random.uniform(key, sway.shape, maxval=2 * jnp.pi)
        sway += width * wave.height * jnp.sin(wave.rate * time + begin)
    aside = jnp.tan(sway[0] / 2)
    above = jnp.tan(sway[1] / 4)
    return unit(pose.forward + aside[:, None] * leftward(pose) + above[:, None] * upright(pose))


def pursue(pose: Pose, targets: ArrayLike) -> Float[Array, "B 3"]:
    """Return the force toward `targets` (3,) or (B, 3) [m]."""
    return unit(jnp.asarray(targets) - pose.position)


def stay_inside(
    pose: Pose, tank: Tank, margin: float, *, ahead: float = 2.0
) -> Float[Array, "B 3"]:
    """Return the inward force: zero further than `margin` [m] from the walls, one at a wall.

    It depends on the body's position `ahead` [s] from now, since it cannot turn at once.
    """
    position = pose.position + ahead * pose.velocity
    low = jnp.asarray(tank.low)
    high = jnp.asarray(tank.high)
    too_low = jnp.maximum(low + margin - position, 0)
    too_high = jnp.maximum(position - (high - margin), 0)
    return (too_low - too_high) / margin


def school(pose: Pose, *, spacing: float, reach: float) -> Float[Array, "B 3"]:
    """Return the force to swim with those nearer than about `reach` [m], and at least `spacing` [m] from them.

    It is Reynolds' three: alignment with the neighbours, cohesion toward them, separation from the nearest.
    """
    offsets = pose.position[:, None] - pose.position[None]
    others = _others(pose)
    nearness = jnp.exp(-jnp.sum((offsets / reach) ** 2, axis=-1)) * others
    total = nearness.sum(axis=1, keepdims=True)
    shares = nearness / (total + jnp.finfo(nearness.dtype).tiny)
    alignment = shares @ pose.forward
    cohesion = -jnp.sum(shares[..., None] * offsets, axis=1) / reach
    separation = jnp.sum(_repulsion(offsets, spacing) * others[..., None], axis=1)
    return alignment + cohesion + SCHOOL_SEPARATION * separation


def keep_apart(pose: Pose, spacing: float, *, ahead: float = 3.0) -> Float[Array, "B 3"]:
    """Return the force away from others: zero if none comes nearer than `spacing` [m] in `ahead` [s], one at contact.

    It depends on the nearest approach if both bodies go on unchanged: a body that cannot turn at once must begin early.
    Two bodies on an exact collision course give way to the same side, each to its left.
    """
    offsets, nearness = _nearest_approaches(pose, spacing, ahead)
    away = offsets + PASSING_SIDE * spacing * leftward(pose)[:, None]
    return jnp.sum(unit(away) * nearness[..., None], axis=1)


def give_way(pose: Pose, spacing: float, *, ahead: float = 3.0) -> Float[Array, " B"]:
    """Return the share of its speed that each body should keep because of those in front of it; 1 without any.

    `spacing` [m] and `ahead` [s] are those of `keep_apart`.
    """
    _, nearness = _nearest_approaches(pose, spacing, ahead)
    toward = unit(pose.position[None] - pose.position[:, None])
    in_front = jnp.maximum(jnp.sum(toward * pose.forward[:, None], axis=-1), 0)
    return 1 - GIVEN_UP_SPEED * jnp.max(in_front * nearness, axis=1)


def prioritise(urgent: Float[Array, "B 3"], other: Float[Array, "B 3"]) -> Float[Array, "B 3"]:
    """Return `urgent` with priority over `other`: all of it if its length is one, only `other` if it is zero."""
    squares = jnp.sum(urgent**2, axis=-1, keepdims=True)
    length = jnp.sqrt(squares + jnp.finfo(urgent.dtype).tiny)
    share = jnp.clip(length, 0, 1)
    return share * urgent / length + (1 - share) * unit(other)


def limit_angles(
    force: Float[Array, "B 3"], pose: Pose, *, max_climb: float = 0.35, max_turn: float = 0.8
) -> Float[Array, "B 3"]:
    """Return `force` as a unit vector no steeper than `max_climb`, at most `max_turn` [rad] off the heading.

    A body that is to go back where it came from rolls on its side to do it; with a limited, longer turn it stays level.
    If the force is vertical, the body goes on straight ahead.
    """
    onward = force + STRAIGHT_ON * pose.forward
    heading = jnp.arctan2(pose.forward[:, 1], pose.forward[:, 0])
    wanted_heading = jnp.arctan2(onward[:, 1], onward[:, 0])
    turn = (wanted_heading - heading + jnp.pi) % (2 * jnp.pi) - jnp.pi
    new_heading = heading + jnp.clip(turn, -max_turn, max_turn)
    level = jnp.sqrt(jnp.sum(onward[:, :2] ** 2, axis=-1) + jnp.finfo(force.dtype).tiny)
    slope = jnp.clip(force[:, 2] / level, -jnp.tan(max_climb), jnp.tan(max_climb))
    return unit(jnp.stack([jnp.cos(new_heading), jnp.sin(new_heading), slope], axis=-1))


def shoal(tank: Tank, *, length: float, speed: float, seed: int = 0) -> Behaviour:
    """Return the behaviour of bodies `length` [m] long that stroll together through `tank` at `speed` [m/s].

    Avoiding others and the glass has priority over company; none dives steeply.
    """

    def behave(pose: Pose, time: Array) -> SteeringTarget:
        stroll = wander(pose, time, seed=seed)
        company = school(pose, spacing=SHOAL_SPACING * length, reach=SHOAL_REACH * length)
        inward = SHOAL_CONTAINMENT * stay_inside(pose, tank, margin=SHOAL_MARGIN * length)
        apart = SHOAL_AVOIDANCE * keep_apart(pose, SHOAL_CLEARANCE * length)
        force = limit_angles(prioritise(apart + inward, stroll + company), pose)
        return steer_along(force, speed * give_way(pose, SHOAL_CLEARANCE * length))

    return behave


def steer_along(force: Float[Array, "B 3"], speed: ArrayLike) -> SteeringTarget:
    """Return the target along `force` at `speed`, one for all or (B,) [m/s]."""
    return SteeringTarget(unit(force), for_each(speed, force))


def _others(pose: Pose) -> Bool[Array, "B B"]:
    """Return a mask of the pairs of two different bodies."""
    return ~jnp.eye(len(pose.position), dtype=bool)


def _nearest_approaches(
    pose: Pose, spacing: float, ahead: float
) -> tuple[Float[Array, "B B 3"], Float[Array, "B B"]]:
    """Return the offset [m] of each body from each other at their nearest approach, and its closeness: 1 at contact.

    Closeness is 0 without an approach below `spacing` [m] within `ahead` [s]; approaches far in the future count less.
    """
    offsets = pose.position[:, None] - pose.position[None]
    drift = pose.velocity[:, None] - pose.velocity[None]
    # The distance |offsets + t·drift| is least at t = -offsets·drift / |drift|².
    squares = jnp.sum(drift**2, axis=-1) + jnp.finfo(offsets.dtype).eps
    time_of_approach = jnp.clip(-jnp.sum(offsets * drift, axis=-1) / squares, 0, ahead)
    nearest = offsets + time_of_approach[..., None] * drift
    distance = jnp.sqrt(jnp.sum(nearest**2, axis=-1) + jnp.finfo(offsets.dtype).tiny)
    nearness = jnp.maximum(1 - distance / spacing, 0)
    return nearest, nearness / (1 + time_of_approach / ahead) * _others(pose)


def _repulsion(offsets: Float[Array, "B K 3"], reach: float) -> Float[Array, "B K 3"]:
    """Return the forces along `offsets` [m], which fall from one at zero distance to zero at `reach` [m]."""
    squares = jnp.sum(offsets**2, axis=-1, keepdims=True)
    distance = jnp.sqrt(squares + jnp.finfo(offsets.dtype).tiny)
    return offsets / distance * jnp.maximum(1 - distance / reach, 0)
