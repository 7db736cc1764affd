"""Exact properties of a system that an emulator may use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.files.numbers import entries
from neuroanimator.state.contacts import Contacts
from neuroanimator.state.layout import Pairs
from neuroanimator.state.reference_shape import Cloud
from neuroanimator.state.segments import Segment, moves_freely, orientations_of
from neuroanimator.state.shape_contacts import ShapeContacts, common_scale

MAX_MIRRORS = 64
"""Maximum number of mirrors whose mixing is cached: every rollout needs it, and it takes a millisecond."""

Probe = tuple[float, float, float, float]
"""Centre [m] in the root's frame and radius [m] of a round part that may touch the ground."""

ProbeModes = tuple[tuple[tuple[float, ...], ...], ...]
"""Displacement of each of P probes along each axis by a unit of the amplitude of each of K shapes: (3, K, P)."""


REVERSED_ALONG = (False, True, False)
"""Entries of a vector that the mirror, which reverses Y, reverses."""

REVERSE_Y = np.array([1.0, -1.0, 1.0])
"""Factors by which it multiplies a vector, axis by axis."""

REVERSED_ABOUT = (True, False, True)
"""Entries of a rotation vector that the mirror reverses: rotations about X and Z."""


@dataclass(frozen=True)
class Mirror:
    """Left and right of a body: the partners that swap when Y is reversed."""

    points: tuple[int, ...]
    """Partner of each mass point; itself on the middle plane."""
    controls: tuple[int, ...]
    """Partner of each control."""

    def to_json(self) -> list[list[int]]:
        """Return plain lists."""
        return [list(self.points), list(self.controls)]

    @classmethod
    def from_json(cls, row: Any, points: int, controls: int, what: str) -> Mirror:
        """Return the mirror `to_json` wrote; ValueError unless it pairs that many `points` and `controls`."""
        point_partners, control_partners = row
        mirror = cls(
            entries(point_partners, f"{what}: mirror", points),
            entries(control_partners, f"{what}: mirror", controls),
        )
        if not pairs_up(mirror.points, points) or not pairs_up(mirror.controls, controls):
            raise ValueError(f"{what}: a mirror that does not pair left and right")
        return mirror


@lru_cache(maxsize=MAX_MIRRORS)
def mixing(partners: tuple[int, ...]) -> tuple[Float[np.ndarray, "C C"], int]:
    """Return (orthogonal matrix (C, C), number of its odd columns): differences of partners, then sums.

    `partners` are those of each control: see `Mirror`.
    """
    count = len(partners)
    units = np.eye(count)
    odd = []
    even = []
    for control, partner in enumerate(partners):
        if partner == control:
            even.append(units[control])
        elif control < partner:
            odd.append((units[control] - units[partner]) / np.sqrt(2))
            even.append((units[control] + units[partner]) / np.sqrt(2))
    columns = np.stack([*odd, *even], axis=1)
    columns.flags.writeable = False
    return columns, len(odd)


def pairs_up(partners: tuple[int, ...], count: int) -> bool:
    """Return whether everything is the partner of its partner."""
    if len(partners) != count:
        return False
    return all(0 <= p < count and partners[p] == i for i, p in enumerate(partners))


@dataclass(frozen=True)
class SoftSwimmer:
    """A soft body that moves freely: its root, then its shapes and their rates, then activations of its muscles."""

    gyration: float
    """Radius of gyration at rest [m]: rotations move nodes by as much."""
    odd: tuple[bool, ...]
    """Whether the mirror reverses each number of the angular velocity, each shape and each rate; empty without a mirror."""


@dataclass(frozen=True)
class BodyGroup:
    """A part of a body, such as a segment or a limb, named by the user."""

    name: str
    entries: tuple[int, ...]
    """Mass points of a deformable body; state entries of any other system."""
    controls: tuple[int, ...]
    """Controls that act on it."""


@dataclass(frozen=True)
class Structure:
    """The exact structure of a state.

    `angles`: integer combinations of the state of which only sine and cosine matter.
    `rates`: (i, j) where state entry j is the time derivative of entry i.
    `plain`: state entries that are features themselves.
    `segments`: how the state changes, in order; empty for a state of plain numbers.
    `probes`: round parts of the root's body, such as feet, whose height over the ground matters.
    `probe_modes`: how shapes displace the probes of a soft body, whose amplitudes follow its angular velocity.
    `symmetry_order`: order of the root's rotational symmetry about its own Z axis;
    `symmetry_controls`: pairs of controls that turn with it, as X and Y do.
    `is_odd`: negating state and control negates the motion (mirror symmetry).
    `cloud`: the mass points of a deformable body, which define its frame; `mirror`: its left and right.
    `external_forces`: (3, C) force [N] in the world per control, if controls are such forces, else empty.
    `groups`: parts of it that move largely independently.
    `has_gravity`: whether the root feels gravity, so that up and down matter.
    `is_immersed`: whether probes measure the distance to the surface of water instead of to the ground.
    `contacts`: points and joints of a jointed body that may touch the ground or reach a stop.
    `shape_contacts`: nodes of a soft body that may touch movers.
    `swimmer`: a soft body with muscles that moves freely in water.
    """

    angles: tuple[tuple[int, ...], ...]
    rates: Pairs
    plain: tuple[int, ...]
    is_odd: bool = False
    segments: tuple[Segment, ...] = ()
    probes: tuple[Probe, ...] = ()
    probe_modes: ProbeModes = ()
    symmetry_order: int = 1
    symmetry_controls: Pairs = ()
    cloud: Cloud | None = None
    mirror: Mirror | None = None
    has_gravity: bool = True
    groups: tuple[BodyGroup, ...] = ()
    external_forces: tuple[tuple[float, ...], ...] = ()
    is_immersed: bool = False
    contacts: Contacts | None = None
    shape_contacts: ShapeContacts | None = None
    swimmer: SoftSwimmer | None = None

    @property
    def is_in_water(self) -> bool:
        """Whether water carries the body, or no ground holds its mass points and no gravity pulls them."""
        return self.swimmer is not None or (
            self.cloud is not None and (self.is_immersed or not self.has_gravity)
        )

    def __str__(self) -> str:
        """Return the numbers of its parts; `repr` is complete, and identifies compiled code."""
        counts = {
            "angles": len(self.angles),
            "plain numbers": len(self.plain),
            "rates": len(self.rates),
            "mass points": self.cloud.count if self.cloud else 0,
            "probes": len(self.probes),
            "groups": len(self.groups),
        }
        told = [f"{count} {name}" for name, count in counts.items() if count]
        if moves_freely(self.segments):
            told.insert(0, "a free root")
        return f"Structure({', '.join(told)})"

    def common_scale(self, scale: Float[np.ndarray, " V"]) -> Float[np.ndarray, " V"]:
        """Return the scales of the numbers of a change, one for all amplitudes of a soft body, and one for all their rates.

        Errors of all shapes add up alike to those of its nodes.
        """
        if self.shape_contacts is not None:
            return self.shape_contacts.common_scale(scale)
        if self.swimmer is not None:
            return common_scale(scale, self.swimmer.gyration)
        return scale

    @property
    def is_soft(self) -> bool:
        """Whether the state holds the amplitudes of shapes of thousands of nodes."""
        return self.shape_contacts is not None or self.swimmer is not None

    @property
    def orientations(self) -> Pairs:
        """(i, j) where a quaternion begins at state entry i and its angular velocity, in the body's frame, at j."""
        return orientations_of(self.segments)
