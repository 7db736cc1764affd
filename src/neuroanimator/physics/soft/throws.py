"""Starts of a body that nothing holds, undeformed: at rest, thrown above its place of rest, or swimming about it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.physics.soft.soft_body import GRAVITY, Points
from neuroanimator.physics.soft.soft_scene import SoftScene
from neuroanimator.physics.starts import root_at_rest, swimming_roots
from neuroanimator.state.rotation import facing, multiply

REST_SHARE = 0.5
"""Share of bodies that begin at rest."""

TILT = 0.5
"""Standard deviation of a thrown body's rotation about each horizontal axis [rad]."""

TRIES = 8
"""Maximum number of throws tried until one begins outside all colliders."""

ROUNDING = 1e-6
"""Rounding error of a distance in float32, over the size of the body."""


def random_roots(
    scene: SoftScene,
    rng: np.random.Generator,
    mean: Points,
    centre: Float[np.ndarray, " 3"],
    movers: Float[np.ndarray, "B D"],
) -> list[Float[np.ndarray, " 13"] | None]:
    """Return positions, quaternions, velocities and angular velocities; None for a body to which movers leave no room.

    `mean` are the nodes in the body's own frame, `centre` is its position at rest, and `movers` are the movers' entries. No
    node is deeper in anything than `SoftScene.margin`, or than the deepest at rest, where a body touches its support.
    """
    if scene.water is not None:
        has_gravity = scene.water.has_gravity
        return list(swimming_roots(scene.sampling, rng, centre, len(movers), has_gravity))
    contacts = scene.contacts(mean, tuple(range(len(mean))))
    rates = np.zeros(scene.movers.rate_size)
    at_rest = contacts.distances(scene.state_at_rest(centre))
    deepest = min(-scene.margin, *(distance.min() for distance in at_rest))
    deepest -= ROUNDING * scene.size
    roots: list[np.ndarray | None] = [None] * len(movers)
    for number, row in enumerate(movers):
        for _ in range(TRIES):
            root = _random_root(scene, rng, centre)
            distances = contacts.distances(np.concatenate([row, rates, root]))
            if all((distance > deepest).all() for distance in distances):
                roots[number] = root
                break
    return roots


def _random_root(
    scene: SoftScene,
    rng: np.random.Generator,
    centre: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, " 13"]:
    """Return position, quaternion, velocity and angular velocity of a body at rest at `centre`, or thrown near it.

    A thrown body is up to its own size above, as fast as after a fall from that height, turned about the vertical, tilted
    and spinning.
    """
    size = scene.size
    if rng.random() < REST_SHARE:
        return root_at_rest(centre)
    tilt = np.concatenate([[2 / TILT], rng.normal(size=2), [0.0]])
    heading = rng.uniform(-np.pi, np.pi)
    quaternion = multiply(tilt / np.linalg.norm(tilt), facing(np.asarray(heading)))
    position = centre + size * rng.uniform((-0.5, -0.5, 0), (0.5, 0.5, 1))
    speed = np.sqrt(-2 * GRAVITY[2] * size) * rng.uniform(0, 1)
    velocity = speed * rng.normal(size=3) / np.sqrt(3)
    angular_velocity = rng.uniform(0, 2) * speed / size * rng.normal(size=3) / np.sqrt(3)
    return np.concatenate([position, quaternion, velocity, angular_velocity])
