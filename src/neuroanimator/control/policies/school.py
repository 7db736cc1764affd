"""A school to look at: many bodies of one policy that swim along together in open water, none beating in time."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.animation.clip import Clip, make_clip
from neuroanimator.animation.motion import MAX_SECONDS, USUAL_SECONDS
from neuroanimator.animation.showcase import dive, swims_under_a_surface
from neuroanimator.control.policies.behaviours import Behaviour, limit_angles, steer_along
from neuroanimator.control.policies.closed_loop import rollout_on_emulator
from neuroanimator.control.policies.policy import Policy, load_policy
from neuroanimator.control.policies.steering import SteeringTarget
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.files.zoo import POLICIES
from neuroanimator.state.pose import Pose

MAX_SCHOOL = 64
"""The most bodies of a school: what a film has room for."""

SPACING = (1.7, 1.1, 0.8)
"""Body lengths between neighbours ahead, beside and above: bodies are long, not high."""

ELONGATION = np.array([0.5, 1.3, 1.6])
"""Weight of distance along each axis when the school is filled: it becomes longer than it is wide."""

JITTER = 0.22
"""Random offset of each from its place in the grid, over the grid's spacing."""

PACE = 0.85
"""Speed of a school, over the highest speed its policy learnt: those that fall behind must be able to catch up."""

CATCHING_UP = 0.25
"""Share of its speed by which a body hurries or waits, at most."""

RETURN = 3.0
"""Body lengths off its place at which a body points half-way there, half-way onward."""

SWAY = (0.0, 0.6, 0.2)
"""Body lengths by which the way of the whole school bends to either side."""

SWAY_PERIOD = 7.0
"""Time of one bend to both sides [s]."""


def school_clips(
    emulator: Emulator,
    count: int,
    *,
    seconds: float | None = None,
    seed: int = 0,
    rate: float | None = None,
) -> list[Clip]:
    """Return the clips of `count` bodies of the emulator's system that swim together, by the policy that ships of it.

    What is drawn is what the policy's own emulator does. Raises ArgumentError where no policy ships, and for a count
    or a time [s] out of range.
    """
    if emulator.definition or emulator.system not in POLICIES:
        raise ArgumentError(
            f"school: no policy of {emulator.system} ships. Systems with one: {', '.join(POLICIES)}."
        )
    if not 1 <= count <= MAX_SCHOOL:
        raise ArgumentError(f"school: wanted 1 to {MAX_SCHOOL} bodies, came {count}.")
    policy = load_policy(emulator.system)
    if seconds is None:
        seconds = USUAL_SECONDS
    if not policy.dt <= seconds <= MAX_SECONDS:
        raise ArgumentError(
            f"seconds: wanted between {policy.dt:g} and {MAX_SECONDS:g}, came {seconds:g}."
        )
    if seed < 0:
        raise ArgumentError(f"seed: wanted 0 or more, came {seed}.")
    motions = school_motion(policy, count, seconds, seed)
    return [make_clip(policy.emulator, one, rate=rate, source="emulator") for one in motions]


def school_motion(
    policy: Policy, count: int, seconds: float, seed: int = 0
) -> Float[np.ndarray, "{count} K S"]:
    """Return the trajectories (K = T+1 states) of a school of `count` bodies; see `school_clips`."""
    starts, behaviour = school_start(policy, count, seed)
    steps = int(np.ceil(seconds / policy.dt - 1e-9))
    return np.asarray(rollout_on_emulator(policy, behaviour, starts, steps, seed=seed), float)


def school_start(
    policy: Policy, count: int, seed: int
) -> tuple[Float[np.ndarray, "{count} S"], Behaviour]:
    """Return (where a school of `count` bodies begins, where each of them goes from there)."""
    emulator = policy.emulator
    cloud = emulator.state_structure.cloud
    assert cloud is not None
    middle = np.array(emulator.rest, float)
    is_under_surface = swims_under_a_surface(emulator)
    if is_under_surface:
        middle = dive(emulator, middle)
    points = middle[: 3 * cloud.count].reshape(-1, 3)
    length = float(np.ptp(points, axis=0).max())
    offsets = length * _grid(count, np.random.default_rng(seed))
    if is_under_surface:
        offsets[:, 2] -= offsets[:, 2].max()
    starts = np.repeat(middle[None], count, axis=0)
    starts[:, : 3 * cloud.count] += np.tile(offsets, cloud.count)
    speed = PACE * float(policy.ranges.high[0])
    return starts, cruise(points.mean(axis=0) + offsets, length=length, speed=speed)


def cruise(places: Float[np.ndarray, "B 3"], *, length: float, speed: float) -> Behaviour:
    """Return the behaviour of bodies `length` [m] long that go along X at `speed` [m/s], each in its place of the school.

    `places` [m] are where they begin; the whole school sways a little on its way.
    """
    sway = length * np.array(SWAY)

    def behave(pose: Pose, time: Array) -> SteeringTarget:
        bend = jnp.sin(2 * jnp.pi * time / SWAY_PERIOD)
        slots = places + jnp.array([speed, 0.0, 0.0]) * time + sway * bend
        offsets = (slots - pose.position) / (RETURN * length)
        force = limit_angles(jnp.array([1.0, 0.0, 0.0]) + offsets, pose)
        hurry = jnp.clip(offsets[:, 0], -1, 1) * CATCHING_UP
        return steer_along(force, speed * (1 + hurry))

    return behave


def _grid(count: int, rng: np.random.Generator) -> Float[np.ndarray, "{count} 3"]:
    """Return places around the origin in body lengths, the nearest of a shaken grid."""
    side = int(np.ceil(count ** (1 / 3))) + 1
    axis = np.arange(-side, side + 1)
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    # Every other row is half a place behind, as in a school.
    shifted = cells + np.array([0.5, 0.0, 0.0]) * ((cells[:, 1] + cells[:, 2]) % 2)[:, None]
    distances = np.linalg.norm(shifted * np.array(SPACING) * ELONGATION, axis=1)
    nearest = shifted[np.argsort(distances, kind="stable")[:count]]
    shaken = nearest + JITTER * rng.uniform(-1, 1, nearest.shape)
    return shaken * np.array(SPACING)
