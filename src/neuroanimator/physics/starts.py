"""Random starts of animals: orientations, and motions about their place of rest."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.definitions.parts import BodySampling
from neuroanimator.state.rotation import NO_ROTATION, facing, multiply, rotate, rotated_by


def root_at_rest(position: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 13"]:
    """Return the position, quaternion, velocity and angular velocity of a body that stands still, upright."""
    return np.concatenate([position, NO_ROTATION, np.zeros(6)])


def swimming_roots(
    sampling: BodySampling,
    rng: np.random.Generator,
    centre: Float[np.ndarray, " 3"],
    count: int,
    has_gravity: bool,
) -> Float[np.ndarray, "count 13"]:
    """Return positions, quaternions, velocities and angular velocities of bodies in water about their place of rest."""
    is_moving = (rng.random(count) >= sampling.rest_share)[:, None]
    roots = np.repeat(root_at_rest(centre)[None], count, axis=0)
    roots[:, 2] += rng.uniform(*sampling.height, count) * is_moving[:, 0]
    orientation = random_orientations(sampling, rng, is_moving, has_gravity)
    velocity = rng.normal(size=(count, 3)) * np.array(sampling.velocity) * is_moving
    roots[:, 3:7] = orientation
    roots[:, 7:10] = rotate(orientation, velocity)
    roots[:, 10:] = rng.normal(size=(count, 3)) * sampling.angular_velocity * is_moving
    return roots


def random_orientations(
    sampling: BodySampling,
    rng: np.random.Generator,
    is_moving: Bool[np.ndarray, "K 1"],
    has_gravity: bool,
) -> Float[np.ndarray, "K 4"]:
    """Return quaternions of any heading; of any orientation if there is no up and down."""
    count = len(is_moving)
    if not has_gravity:
        quaternions = rng.normal(size=(count, 4))
        return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    heading = facing(rng.uniform(-np.pi, np.pi, count))
    upright = facing(np.zeros(count))
    tilt = rng.normal(size=(count, 3)) * sampling.tilt * is_moving
    return multiply(heading, rotated_by(upright, tilt))
