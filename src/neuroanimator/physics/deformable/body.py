"""A mass-spring body and its surroundings: mass points, springs, muscles and faces as arrays, water and ground."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.physics.water import Water, lift_of, wetness
from neuroanimator.state.arrays import AnyArray

GRAVITY = 9.81
"""Acceleration of free fall [m/s²]."""

BALANCED = 1e-6
"""Maximum net force at rest of a balanced body, as a share of all forces."""


@dataclass(frozen=True)
class Ground:
    """Level, elastic and rough ground at height 0."""

    stiffness: float
    """Stiffness of the ground under every mass point [N/m]."""
    damping: float
    """Damping [s/m]: contact forces are elastic ones times 1 - damping · upward velocity, never negative (Hunt, Crossley)."""
    friction: float
    """Coefficient of friction."""
    slip: float
    """Sliding speed at which friction is nearly full [m/s]."""


@dataclass(frozen=True, eq=False)
class Body:
    """A mass-spring body in SI units: N mass points, P springs, M muscles, C controls, F faces."""

    names: tuple[str, ...]
    """Names of the mass points."""
    positions: Float[np.ndarray, "N 3"]
    """Positions of the mass points at rest [m]."""
    masses: Float[np.ndarray, " N"]
    """Masses of the mass points [kg]."""
    springs: Int[np.ndarray, "P 2"]
    """The two mass points each spring connects."""
    stiffness: Float[np.ndarray, " P"]
    """Stiffness of the springs [N/m]."""
    damping: Float[np.ndarray, " P"]
    """Damping of the springs along their length [N·s/m]."""
    muscles: Float[np.ndarray, "P M"]
    """Share of its length by which each fully activated muscle shortens each spring."""
    external_forces: Float[np.ndarray, "3 C"]
    """Force on the whole body per control [N], spread by mass."""
    faces: Int[np.ndarray, "F 4"]
    """Corners, counterclockwise from outside; the last of a triangle is its first."""
    time_constant: float = 0.0
    """Time constant with which muscles follow their controls [s]."""
    water: Water | None = None
    ground: Ground | None = None
    rest_height: float = 0.0
    """Height added to every mass point at rest [m]."""
    spring_groups: tuple[str, ...] = ()
    """Name of the group of each spring; empty if groups have no names."""
    varied: tuple[str, ...] = ()
    """Targets of the body's parameters, the last entries of its state: see `body_parameters.py`."""
    lengths: Float[np.ndarray, " P"] = field(init=False)
    """Lengths of the springs without force [m]: those at rest, without the stretches that carry the body."""
    lift: Float[np.ndarray, " N"] = field(init=False)
    """Weight of the water each mass point displaces, over its own."""
    face_shares: Float[np.ndarray, "F N"] = field(init=False)
    """Share of each mass point in a face's velocity, and in the force on it."""

    def __post_init__(self) -> None:
        lift = lift_of(self.positions, self.masses, self.water)
        object.__setattr__(self, "lift", lift)
        object.__setattr__(self, "lengths", self.spans - _stretches_at_rest(self))
        object.__setattr__(self, "face_shares", _face_shares(self.faces, len(self.masses)))

    @property
    def extents(self) -> Float[np.ndarray, "P 3"]:
        """Vectors from the first end of each spring to its second at rest [m]."""
        first, second = self.springs.T
        return self.positions[second] - self.positions[first]

    @property
    def spans(self) -> Float[np.ndarray, " P"]:
        """Distances between the ends of the springs at rest [m]."""
        return np.linalg.norm(self.extents, axis=1)

    @property
    def force_densities(self) -> Float[np.ndarray, " P"]:
        """Tension of each spring at rest, over its length [N/m]."""
        return self.stiffness * (1 - self.lengths / self.spans)

    @property
    def has_gravity(self) -> bool:
        """Whether gravity is felt: not if water is everywhere and nothing distinguishes up from down."""
        return self.water is None or self.water.has_gravity


def point_forces(
    body: Body,
    positions: Float[AnyArray, "N 3 ..."],
    velocities: Float[AnyArray, "N 3 ..."],
    masses: Float[AnyArray, "N ..."],
    lift: Float[AnyArray, "N ..."],
    wet: Float[AnyArray, "N ..."],
) -> Float[AnyArray, "N 3 ..."]:
    """Return drag, weight and the ground's force on mass points [N] with given `masses`, `lift` and wetness."""
    xp = positions.__array_namespace__()
    force = xp.zeros_like(positions)
    if body.water is not None:
        force = force - body.water.drag * (masses * wet)[:, None] * velocities
    if body.has_gravity:
        upward = masses * GRAVITY * (lift * wet - 1)
        level = xp.zeros_like(upward)
        force = force + xp.stack([level, level, upward], axis=1)
    if body.ground is not None:
        force = force + _ground_forces(body.ground, positions, velocities)
    return force


def _ground_forces(
    ground: Ground, positions: Float[AnyArray, "N 3 ..."], velocities: Float[AnyArray, "N 3 ..."]
) -> Float[AnyArray, "N 3 ..."]:
    xp = positions.__array_namespace__()
    x, y, z = (velocities[:, axis] for axis in range(3))
    depth = xp.maximum(-positions[:, 2], 0)
    damped = xp.maximum(1 - ground.damping * z, 0)
    upward = ground.stiffness * depth * damped
    speed = xp.sqrt(x * x + y * y + ground.slip**2)
    sideways = -ground.friction * upward / speed
    return xp.stack([sideways * x, sideways * y, upward], axis=1)


def length_jacobian(body: Body) -> Float[np.ndarray, "P X"]:
    """Return the derivative of each spring's length by each coordinate, at rest.

    The X = 3N coordinates are those of `positions`, one after another.
    """
    first, second = body.springs.T
    directions = body.extents / body.spans[:, None]
    count = len(body.springs)
    rows = np.arange(count)
    jacobian = np.zeros((count, *body.positions.shape))
    jacobian[rows, second] = directions
    jacobian[rows, first] = -directions
    return jacobian.reshape(count, -1)


def _stretches_at_rest(body: Body) -> Float[np.ndarray, " P"]:
    """Return the stretches of the springs at rest [m] that balance lift, weight and ground.

    Without them the defined shape would sag. Of all balanced stretches they store the least energy. They are zero for
    a body that falls or rises, which has no balance.
    """
    load = _load_at_rest(body)
    if not _is_balanced(body, load):
        return np.zeros(len(body.springs))
    jacobian = length_jacobian(body)
    stiffness = jacobian.T @ (body.stiffness[:, None] * jacobian)
    sag = np.linalg.lstsq(stiffness, load.ravel(), rcond=None)[0]
    return jacobian @ sag


def _is_balanced(body: Body, load: Float[np.ndarray, "N 3"]) -> bool:
    """Return whether there is a `load` [N] that springs alone can carry: it neither moves nor turns the body."""
    arms = body.positions - body.positions.mean(axis=0)
    force = load.sum(axis=0)
    torque = np.cross(arms, load).sum(axis=0)
    net = np.concatenate([force, torque / np.linalg.norm(arms)])
    total = np.abs(load).sum()
    return bool(np.abs(load).any() and np.abs(net).max() <= BALANCED * total)


def _load_at_rest(body: Body) -> Float[np.ndarray, "N 3"]:
    """Return the force of lift, weight and ground on every mass point at rest [N]."""
    positions = body.positions + np.array([0.0, 0.0, body.rest_height])
    wet = wetness(body.water, positions[:, 2])
    velocities = np.zeros_like(positions)
    return point_forces(body, positions, velocities, body.masses, body.lift, wet)


def _face_shares(faces: Int[np.ndarray, "F 4"], count: int) -> Float[np.ndarray, "F N"]:
    shares = np.zeros((len(faces), count))
    for row, face in zip(shares, faces, strict=True):
        corners = np.unique(face)
        row[corners] = 1 / len(corners)
    return shares


def area_vectors(
    positions: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "F 4"]
) -> Float[np.ndarray, "F 3"]:
    """Return the normal of each face times its area [m²], from the positions [m] of its corners."""
    p = positions[faces]
    return np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1]) / 2
