"""A mass-spring body: what its definition says, as checked arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from neuroanimator.errors import ArgumentError


@dataclass(frozen=True)
class Water:
    """A medium that resists faces moving into it, and carries."""

    push: float
    """μ [kg/(m²·s)]: a face of area A moving outward at v is pushed back by μ·A·v; one moving inward is not."""
    drag: float = 0.0
    """[1/s] Damping of every mass point's motion, over its mass."""
    buoyancy: float = 1.0
    """Weight of the water the body displaces, over its own."""
    surface: float | None = None
    """Height of the surface [m]; None: water everywhere, and nothing weighs anything."""
    depth: float = 0.1
    """[m] Over which a mass point passes from air to water: about its size."""


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
    places: Float[np.ndarray, "N 3"]
    """Where the mass points are at rest [m]."""
    masses: Float[np.ndarray, " N"]
    springs: np.ndarray
    """(P, 2) mass points each spring connects."""
    stiffness: Float[np.ndarray, " P"]
    damping: Float[np.ndarray, " P"]
    muscles: Float[np.ndarray, "P M"]
    """By which share of its length each contraction shortens each spring."""
    pushes: Float[np.ndarray, "3 C"]
    """Force on the whole body [N] per control, spread by mass."""
    faces: np.ndarray
    """(F, 4) corners, counterclockwise from outside; the last of a triangle is its first."""
    response: float = 0.0
    """[s] Time constant with which muscles follow their controls."""
    water: Water | None = None
    ground: Ground | None = None
    lengths: Float[np.ndarray, " P"] = field(init=False)
    """Rest lengths of the springs [m]: their lengths at rest."""
    face_shares: Float[np.ndarray, "F N"] = field(init=False)
    """How a face's speed is that of its corners, and how its force is shared among them."""

    def __post_init__(self) -> None:
        extent = self.places[self.springs[:, 1]] - self.places[self.springs[:, 0]]
        object.__setattr__(self, "lengths", np.linalg.norm(extent, axis=1))
        object.__setattr__(self, "face_shares", _shares(self.faces, len(self.masses)))

    @property
    def weighs(self) -> bool:
        """Whether gravity is felt: not where water is everywhere."""
        return self.water is None or self.water.surface is not None


def _shares(faces: np.ndarray, count: int) -> np.ndarray:
    shares = np.zeros((len(faces), count))
    for row, corners in zip(shares, faces, strict=True):
        row[np.unique(corners)] = 1 / len(np.unique(corners))
    return shares


def linear_modes(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return (frequencies (3N,) [rad/s], dampings (3N,) [1/s]) of small vibrations about rest, ascending.

    A mode's amplitude falls as exp(-damping · t) if it is underdamped.
    """
    extent = body.places[body.springs[:, 1]] - body.places[body.springs[:, 0]]
    along = extent / body.lengths[:, None]
    stretch = np.zeros((len(body.springs), *body.places.shape))
    rows = np.arange(len(body.springs))
    stretch[rows, body.springs[:, 1]], stretch[rows, body.springs[:, 0]] = along, -along
    per_root_mass = stretch.reshape(len(stretch), -1) / np.sqrt(np.repeat(body.masses, 3))
    squares, modes = np.linalg.eigh(per_root_mass.T @ (body.stiffness[:, None] * per_root_mass))
    friction = np.einsum("pi,p,pi->i", per_root_mass @ modes, body.damping, per_root_mass @ modes)
    return np.sqrt(np.maximum(squares, 0)), friction / 2


def largest_step(body: Body) -> float:
    """Return the largest step [s] at which symplectic Euler is stable for small vibrations about rest.

    For ẍ = -ω² x - 2d ẋ it is (√(d² + ω²) - d) · 2/ω².
    """
    frequency, damping = (numbers[6:] for numbers in linear_modes(body))
    if not len(frequency) or frequency[-1] <= 0:
        raise ArgumentError("springs: the body has no springs that hold it together.")
    frequency = np.maximum(frequency, frequency[-1] * 1e-6)
    return float(np.min(2 / frequency**2 * (np.sqrt(damping**2 + frequency**2) - damping)))
