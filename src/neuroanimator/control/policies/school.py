"""A school for films: many bodies of one policy that swim together in open water, unsynchronised."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.animation.motion import checked_steps
from neuroanimator.animation.showcase import dive, swims_under_a_surface, whole_body
from neuroanimator.control.policies.behaviours import Behaviour, limit_angles, steer_along
from neuroanimator.control.policies.closed_loop import rollout_on_emulator
from neuroanimator.control.policies.policy import Policy, load_policy
from neuroanimator.control.policies.steering import SteeringTarget
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.files.zoo import POLICIES
from neuroanimator.state.pose import Pose, read_pose

MAX_SCHOOL = 64
"""Maximum number of bodies in a school: what fits into a film."""

SPACING = (1.7, 1.1, 0.8)
"""Spacing of neighbours ahead, beside and above [body lengths]: bodies are long, not high."""

ELONGATION = np.array([0.5, 1.3, 1.6])
"""Weight of distance along each axis when places are filled: the school becomes longer than wide."""

JITTER = 0.22
"""Random offset of each body from its grid position, over the grid's spacing."""

PACE = 0.85
"""Speed of a school, over its policy's maximum: bodies that fall behind must be able to catch up."""

CATCHING_UP = 0.25
"""Maximum share of its speed by which a body hurries or waits."""

RETURN = 3.0
"""Distance from its place at which a body points half-way between it and straight ahead [body lengths]."""

SWAY = (0.0, 0.6, 0.2)
"""Amplitude by which the path of the whole school sways along each axis [body lengths]."""

SWAY_PERIOD = 7.0
"""Period of this sway [s]."""


def school_of(
    emulator: Emulator, count: int, seconds: float | None = None, seed: int = 0
) -> tuple[Emulator, Float[np.ndarray, "{count} K S"]]:
    """Return (the emulator inside the policy that ships for the emulator's system, motions of `count` bodies by it).

    They swim together. Raises ArgumentError if no policy ships, and for a count or a time [s] out of range.
    """
    if emulator.definition or emulator.system not in POLICIES:
        raise ArgumentError(
            f"school: no policy of {emulator.system} ships. Systems with one: {', '.join(POLICIES)}."
        )
    if not 1 <= count <= MAX_SCHOOL:
        raise ArgumentError(f"school: wanted 1 to {MAX_SCHOOL} bodies, got {count}.")
    policy = load_policy(emulator.system)
    return policy.emulator, school_motion(policy, count, seconds, seed)


def school_motion(
    policy: Policy, count: int, seconds: float | None = None, seed: int = 0
) -> Float[np.ndarray, "{count} K S"]:
    """Return the trajectories (K = T+1 states) of a school of `count` bodies; see `school_of`."""
    steps = checked_steps(seconds, seed, policy.dt)
    starts, behaviour = school_start(policy, count, seed)
    return np.asarray(rollout_on_emulator(policy, behaviour, starts, steps, seed=seed), float)


def school_start(
    policy: Policy, count: int, seed: int
) -> tuple[Float[np.ndarray, "{count} S"], Behaviour]:
    """Return (the initial states of a school of `count` bodies, their behaviour)."""
    emulator = policy.emulator
    middle = np.array(emulator.rest, float)
    is_under_surface = swims_under_a_surface(emulator)
    if is_under_surface:
        middle = dive(emulator, middle)
    entries, length = whole_body(emulator)
    offsets = length * _grid(count, np.random.default_rng(seed))
    if is_under_surface:
        offsets[:, 2] -= offsets[:, 2].max()
    starts = np.repeat(middle[None], count, axis=0)
    starts[:, entries] += np.tile(offsets, (entries.stop - entries.start) // 3)
    speed = PACE * float(policy.ranges.high[0])
    places = read_pose(emulator.state_structure, middle).position + offsets
    return starts, cruise(places, length=length, speed=speed)


def cruise(places: Float[np.ndarray, "B 3"], *, length: float, speed: float) -> Behaviour:
    """Return the behaviour of bodies `length` [m] long that move along X at `speed` [m/s], each in its place of the school.

    `places` [m] are their initial positions; the whole school sways a little on its way.
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
    """Return the positions of a jittered grid nearest to the origin [body lengths]."""
    side = int(np.ceil(count ** (1 / 3))) + 1
    axis = np.arange(-side, side + 1)
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    # Every other row is half a place behind, as in a school.
    shifted = cells + np.array([0.5, 0.0, 0.0]) * ((cells[:, 1] + cells[:, 2]) % 2)[:, None]
    distances = np.linalg.norm(shifted * np.array(SPACING) * ELONGATION, axis=1)
    nearest = shifted[np.argsort(distances, kind="stable")[:count]]
    shaken = nearest + JITTER * rng.uniform(-1, 1, nearest.shape)
    return shaken * np.array(SPACING)
