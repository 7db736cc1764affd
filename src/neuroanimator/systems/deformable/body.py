"""A mass-spring body: what its definition says, as checked arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import ArgumentError

GRAVITY = 9.81
"""[m/s²]"""
BALANCED = 1e-6
"""Share of all forces at rest that may be left over in a body that keeps its place."""


@dataclass(frozen=True)
class Water:
    """A medium that resists faces moving into it, and carries."""

    face_drag: float
    """μ [kg/(m²·s)]: a face of area A moving outward at v is pushed back by μ·A·v; one moving inward is not."""
    drag: float = 0.0
    """[1/s] Damping of every mass point's motion, over its mass."""
    buoyancy: float = 1.0
    """Weight of the water the body displaces, over its own."""
    surface: float | None = None
    """Height of the surface [m]; None: water everywhere, and nothing weighs anything unless it is righted."""
    depth: float = 0.1
    """[m] Over which a mass point passes from air to water: about its size."""
    righting: float = 0.0
    """[m] How far the centre of buoyancy lies above the centre of mass at rest: what turns a body belly down."""


@dataclass(frozen=True)
class Ground:
    """Level, elastic and rough ground at height 0."""

    stiffness: float
    """[N/m] under every mass point."""
    damping: float
    """[s/m]: contact forces are 1 - damping · rising speed times the elastic one, never negative (Hunt, Crossley)."""
    friction: float
    """Largest sideways force over the upward one."""
    slip: float
    """[m/s] Sliding speed at which friction is nearly all there."""


@dataclass(frozen=True, eq=False)
class Body:
    """A mass-spring body in SI units."""

    names: tuple[str, ...]
    """Of the mass points."""
    positions: Float[np.ndarray, "N 3"]
    """Where the mass points are at rest [m]."""
    masses: Float[np.ndarray, " N"]
    springs: np.ndarray
    """(P, 2) mass points each spring connects."""
    stiffness: Float[np.ndarray, " P"]
    damping: Float[np.ndarray, " P"]
    muscles: Float[np.ndarray, "P M"]
    """By which share of its length each contraction shortens each spring."""
    external_forces: Float[np.ndarray, "3 C"]
    """Force on the whole body [N] per control, spread by mass."""
    faces: np.ndarray
    """(F, 4) corners, counterclockwise from outside; the last of a triangle is its first."""
    time_constant: float = 0.0
    """[s] Time constant with which muscles follow their controls."""
    water: Water | None = None
    ground: Ground | None = None
    rest_height: float = 0.0
    """[m] Added to the height of every mass point where the body is put at rest."""
    lengths: Float[np.ndarray, " P"] = field(init=False)
    """Lengths of the springs without force [m]: those at rest, less what carries the body there."""
    lift: Float[np.ndarray, " N"] = field(init=False)
    """Weight of the water each mass point displaces, over its own."""
    face_shares: Float[np.ndarray, "F N"] = field(init=False)
    """How a face's speed is that of its corners, and how its force is shared among them."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "lift", _lift(self.positions, self.masses, self.water))
        object.__setattr__(self, "lengths", self.spans - _stretches(self))
        object.__setattr__(self, "face_shares", _shares(self.faces, len(self.masses)))

    @property
    def spans(self) -> Float[np.ndarray, " P"]:
        """How far apart the ends of the springs are at rest [m]."""
        return np.linalg.norm(
            self.positions[self.springs[:, 1]] - self.positions[self.springs[:, 0]], axis=1
        )

    @property
    def has_gravity(self) -> bool:
        """Whether gravity is felt: not where water is everywhere and nothing tells up from down."""
        return self.water is None or self.water.surface is not None or self.water.righting > 0


def _lift(positions: np.ndarray, masses: np.ndarray, water: Water | None) -> np.ndarray:
    """Return (N,) the lift of every mass point over its weight: it grows upward where the body is righted.

    It is linear in the place, so that its sum is that of the whole body and its centre lies `righting` above that of
    mass: Σ m r (1 + a·r) = Σ m r rᵀ a.
    """
    if water is None:
        return np.zeros(len(masses))
    if not water.righting:
        return np.full(len(masses), water.buoyancy)
    centred = positions - masses @ positions / masses.sum()
    spread = centred.T @ (masses[:, None] * centred) / masses.sum()
    slope = np.linalg.lstsq(spread, np.array([0.0, 0.0, water.righting]), rcond=None)[0]
    return water.buoyancy * (1 + centred @ slope)


def _stretches(body: Body) -> np.ndarray:
    """Return (P,) by how much springs are stretched at rest [m], where they carry lift, weight and ground in balance.

    Without them the shape as written down would sag. Of all stretches in balance they store the least energy. Where
    the body falls or rises there is no balance, and none of them.
    """
    load = _load_at_rest(body)
    arms = body.positions - body.positions.mean(axis=0)
    net = np.concatenate(
        [load.sum(axis=0), np.cross(arms, load).sum(axis=0) / np.linalg.norm(arms)]
    )
    if not np.abs(load).any() or np.abs(net).max() > BALANCED * np.abs(load).sum():
        return np.zeros(len(body.springs))
    pulls = _pulls(body)
    sag = np.linalg.lstsq(pulls.T @ (body.stiffness[:, None] * pulls), load.ravel(), rcond=None)[0]
    return pulls @ sag


def _load_at_rest(body: Body) -> np.ndarray:
    """Return what lift, weight and ground do to every mass point (N, 3) at rest [N]."""
    load = np.zeros_like(body.positions)
    heights = body.positions[:, 2] + body.rest_height
    if body.has_gravity:
        wet = np.ones_like(heights)
        if body.water is not None and body.water.surface is not None:
            wet = np.clip((body.water.surface - heights) / body.water.depth + 0.5, 0, 1)
        load[:, 2] += GRAVITY * body.masses * (body.lift * wet - 1)
    if body.ground is not None:
        load[:, 2] += body.ground.stiffness * np.maximum(-heights, 0)
    return load


def _pulls(body: Body) -> np.ndarray:
    """Return (P, 3N) by how much each spring is stretched where each coordinate grows by 1 m, about rest."""
    first, second = body.springs.T
    along = (body.positions[second] - body.positions[first]) / body.spans[:, None]
    stretch, rows = np.zeros((len(along), *body.positions.shape)), np.arange(len(along))
    stretch[rows, second] = along
    stretch[rows, first] = -along
    return stretch.reshape(len(stretch), -1)


def _shares(faces: np.ndarray, count: int) -> np.ndarray:
    shares = np.zeros((len(faces), count))
    for row, corners in zip(shares, faces, strict=True):
        row[np.unique(corners)] = 1 / len(np.unique(corners))
    return shares


def largest_step(body: Body) -> float:
    """Return the largest step δt [s] at which symplectic Euler is stable for small vibrations about rest.

    Of ẍ + D ẋ + K x = 0 that is where 4 - 2 δt D - δt² K stops being positive definite. Its roots μ = 1/δt, of
    μ² - μ D/2 - K/4, are the eigenvalues of a symmetric matrix twice as large. Springs, water and ground all push
    at once. Tu's semi-implicit scheme has the same limit: at rest its springs' effective stiffness is zero.
    """
    stiffness, friction = _linear_springs(body)
    if not stiffness.any():
        raise ArgumentError("springs: the body has no springs that hold it together.")
    stiffness, friction = stiffness + _linear_ground(body), friction + _linear_water(body)
    squares, modes = np.linalg.eigh(stiffness)
    root = (modes * np.sqrt(np.maximum(squares, 0))) @ modes.T / 2
    return float(
        1 / np.linalg.eigvalsh(np.block([[friction / 2, root], [root, np.zeros_like(root)]]))[-1]
    )


def _linear_springs(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return the springs' stiffness [1/s²] and damping [1/s] about rest, both (3N, 3N) and over the masses."""
    pulls = _pulls(body) / _roots(body)
    return pulls.T @ (body.stiffness[:, None] * pulls), pulls.T @ (body.damping[:, None] * pulls)


def _linear_ground(body: Body) -> np.ndarray:
    """Return the ground's stiffness (3N, 3N) [1/s²] over the masses, as if all mass points touched it."""
    upward = np.zeros_like(body.positions)
    upward[:, 2] = 0.0 if body.ground is None else body.ground.stiffness
    return np.diag(upward.ravel() / _roots(body) ** 2)


def _linear_water(body: Body) -> np.ndarray:
    """Return the water's damping (3N, 3N) [1/s] over the masses, as if all faces moved outward at rest."""
    size = body.positions.size
    if body.water is None:
        return np.zeros((size, size))
    corners = body.positions[body.faces]
    area = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
    weights = (
        np.sqrt(body.water.face_drag / np.linalg.norm(area, axis=1)) if len(area) else np.zeros(0)
    )
    flows = (weights[:, None, None] * body.face_shares[:, :, None] * area[:, None]).reshape(
        len(area), size
    )
    return body.water.drag * np.eye(size) + (flows / _roots(body)).T @ (flows / _roots(body))


def _roots(body: Body) -> np.ndarray:
    """Return (3N,) the root of the mass each coordinate moves."""
    return np.sqrt(np.repeat(body.masses, 3))
