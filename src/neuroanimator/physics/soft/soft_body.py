"""A soft body and its surroundings: nodes, springs, tetrahedra, faces, pins and colliders as arrays."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.physics.water import Water
from neuroanimator.state.shape_contacts import BoxCollider, RoundCollider

GRAVITY = (0.0, 0.0, -9.81)
"""Acceleration of free fall [m/s²]."""


@dataclass(frozen=True)
class Air:
    """Air around a soft body."""

    drag: float = 0.5
    """Rate at which nodes take on the wind's velocity [1/s]."""
    density: float = 0.0
    """Density times drag coefficient of a face across the wind [kg/m³]; with 0 faces feel no wind."""
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the air [m/s]."""


Points = Float[np.ndarray, "N 3"]
"""Positions of the nodes [m], or their velocities [m/s]."""

Played = tuple[Float[np.ndarray, "F-1 N 3 ..."], Float[np.ndarray, "F-1 N 3 ..."]]
"""Positions [m] and velocities [m/s] after each frame."""

Place = tuple[float, float, float]
"""Position relative to a mover, along the mover's axes [m]."""


@dataclass(frozen=True)
class MovingPlane:
    """A collider: the half-space under a plane."""

    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit vector away from the half-space, which does not turn."""
    friction: float = 0.4
    """Largest sideways force over the normal one."""
    mover: int = 0
    """Number of the mover it goes with."""
    point: Place = (0.0, 0.0, 0.0)


COLOURED = {
    "pair": ("pairs", "stiffness", "damping", "muscles"),
    "tetrahedron": ("tetrahedra", "bulk_stiffness"),
    "face": ("faces",),
}
"""Arrays of a body that are put in the order of colours, by kind of element."""


@dataclass(frozen=True, eq=False)
class SoftBody:
    """A soft body in SI units: N nodes, P springs, T tetrahedra, F faces, K pins."""

    positions: Points
    """Positions of the nodes at rest [m]."""
    masses: Float[np.ndarray, " N"]
    """Masses of the nodes [kg]."""
    faces: Int[np.ndarray, "F 3"]
    """Corners of the surface's triangles, counterclockwise from outside."""
    pairs: Int[np.ndarray, "P 2"]
    """The two nodes each spring connects."""
    stiffness: Float[np.ndarray, " P"]
    """Stiffness of the springs [N/m]."""
    damping: Float[np.ndarray, " P"]
    """Damping of the springs along their length [N·s/m]."""
    tetrahedra: Int[np.ndarray, "T 4"]
    """Corners of the tetrahedra that keep their volume; empty for a cloth."""
    bulk_stiffness: Float[np.ndarray, " T"]
    """Pressure per change of volume of each tetrahedron [Pa/m³]."""
    pins: Int[np.ndarray, " K"]
    """Nodes that are held, and moved, from outside."""
    air: Air = Air()
    capsules: tuple[RoundCollider, ...] = ()
    boxes: tuple[BoxCollider, ...] = ()
    planes: tuple[MovingPlane, ...] = ()
    margin: float = 0.0
    """Distance at which nodes touch colliders: half a cloth's thickness [m]."""
    muscles: Float[np.ndarray, "P M"] = field(default_factory=lambda: np.zeros((0, 0)))
    """Share of its length by which each fully activated muscle shortens each spring; by default there are none."""
    time_constant: float = 0.0
    """Time constant with which muscles follow their controls [s]."""
    water: Water | None = None
    holders: Int[np.ndarray, " _"] = field(default_factory=lambda: np.zeros(0, int))
    """Number of the mover that holds each pin; by default the first."""
    held: Float[np.ndarray, "_ 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    """Positions of the pins relative to their movers [m]; by default those at rest."""
    pair_colours: Int[np.ndarray, " _"] = field(init=False)
    """First spring of each colour, and the number of springs: those of one colour share no node."""
    tetrahedron_colours: Int[np.ndarray, " _"] = field(init=False)
    face_colours: Int[np.ndarray, " _"] = field(init=False)

    def __post_init__(self) -> None:
        if not len(self.muscles):
            object.__setattr__(self, "muscles", np.zeros((len(self.pairs), 0)))
        if not len(self.holders):
            object.__setattr__(self, "holders", np.zeros(len(self.pins), int))
        if not len(self.held):
            object.__setattr__(self, "held", self.positions[self.pins])
        for kind, names in COLOURED.items():
            order, starts = _by_colour(getattr(self, names[0]))
            object.__setattr__(self, f"{kind}_colours", starts)
            for name in names:
                object.__setattr__(self, name, getattr(self, name)[order])

    @property
    def lengths(self) -> Float[np.ndarray, " P"]:
        """Lengths of the springs at rest [m]."""
        first, second = self.pairs.T
        return np.linalg.norm(self.positions[second] - self.positions[first], axis=1)

    @property
    def volumes(self) -> Float[np.ndarray, " T"]:
        """Volumes of the tetrahedra at rest [m³]."""
        return tetrahedron_volumes(self.positions, self.tetrahedra)

    @property
    def inverse_masses(self) -> Float[np.ndarray, " N"]:
        """Inverse masses of the nodes [1/kg]; 0 for pins."""
        inverse = 1 / self.masses
        inverse[self.pins] = 0
        return inverse


def tetrahedron_volumes(
    positions: Points, tetrahedra: Int[np.ndarray, "T 4"]
) -> Float[np.ndarray, " T"]:
    """Return the signed volumes of `tetrahedra` [m³]."""
    corners = positions[tetrahedra]
    edges = corners[:, 1:] - corners[:, :1]
    return np.linalg.det(edges) / 6


def _by_colour(elements: Int[np.ndarray, "E K"]) -> tuple[np.ndarray, np.ndarray]:
    """Return (the order of `elements` by colour, the first index of each colour and the end), by greedy colouring."""
    used: dict[int, set[int]] = defaultdict(set)
    colours = np.zeros(len(elements), int)
    for element, nodes in enumerate(elements.tolist()):
        taken = set().union(*(used[node] for node in nodes))
        colour = 0
        while colour in taken:
            colour += 1
        colours[element] = colour
        for node in nodes:
            used[node].add(colour)
    order = np.argsort(colours, kind="stable")
    count = int(colours.max(initial=-1)) + 1
    return order, np.searchsorted(colours[order], np.arange(count + 1))
