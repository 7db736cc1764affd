"""Kinds of state segments: their features in the body's own frame, and how they change.

A state is a sequence of segments. A position moves along the body's own axes, a quaternion is rotated, a lag follows its
control; each kind is a small class here, and `body_frame.Frame` combines them.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

from jaxtyping import Float

from neuroanimator.files.numbers import entries, listed, number, whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import MAX_NUMBERS, Pairs
from neuroanimator.state.mover_poses import moved
from neuroanimator.state.reference_shape import Cloud, flat_of, points_of
from neuroanimator.state.rotation import (
    rotate_in_plane,
    rotated_by,
    rotation_between,
    to_body_axes,
    to_world_axes,
    two_axes,
)
from neuroanimator.text import quoted

MAX_RESPONSE = 10.0
"""Maximum time constant of a lag in a definition [s]."""

Coasting = Any
"""Change by a segment's own rate in a super step: an array (..., V), or 0.0 without a rate."""


class Surroundings(NamedTuple):
    """Inputs of a segment's change besides the segment itself."""

    root: Float[AnyArray, "... R"]
    """Rotation of the root: its quaternion (R = 4), its heading (R = 1), or nothing (R = 0)."""
    control: Float[AnyArray, "... C"] | None
    """The controls that lags follow; with None lags stay."""
    dt: float
    """Duration of the change [s]."""


@dataclass(frozen=True, kw_only=True)
class Segment(abc.ABC):
    """Consecutive state entries that change in one way.

    Entries are those of a state (..., size), changes have `change_size` numbers, added along the axes of `to_world` and
    `to_body`; in this class these are the state's own.
    """

    kind: ClassVar[str]
    """Its name in files."""
    is_shown: ClassVar[bool] = False
    """Whether its entries along the body's axes are features."""
    size: int
    """Number of state entries."""
    rate: int = -1
    """State entry where its rate of change begins; -1 if none is known or used."""

    @property
    def change_size(self) -> int:
        """Number of entries of a change."""
        return self.size

    @property
    def local_size(self) -> int:
        """Length of the result of `local`; 0 for a segment that is not shown."""
        return self.size if self.is_shown else 0

    def local(
        self, entries: Float[AnyArray, "... S"], root: Float[AnyArray, "... R"], cloud: Cloud | None
    ) -> Float[AnyArray, "... L"]:
        """Return the entries in the body's own frame, independent of position and heading."""
        return self.to_body(root, entries)

    def axes(
        self, entries: Float[AnyArray, "... S"], cloud: Cloud | None
    ) -> Float[AnyArray, "... R"] | None:
        """Return the quaternion or heading that gives the body's axes; None for other segments."""
        return None

    def coasting(self, state: Float[AnyArray, "... S"], dt: float) -> Coasting:
        """Return the change by the segment's own rate in `dt` [s]; 0.0 if that is left to the network."""
        if self.rate < 0:
            return 0.0
        return dt * state[..., self.rate : self.rate + self.change_size]

    def to_world(
        self, root: Float[AnyArray, "... R"], change: Float[AnyArray, "... V"]
    ) -> Float[AnyArray, "... V"]:
        """Return a change along the body's axes as one along the axes of the state."""
        return change

    def to_body(
        self, root: Float[AnyArray, "... R"], change: Float[AnyArray, "... V"]
    ) -> Float[AnyArray, "... V"]:
        """Return a change along the axes of the state as one along the body's axes."""
        return change

    def apply(
        self,
        entries: Float[AnyArray, "... S"],
        change: Float[AnyArray, "... V"],
        coasting: Coasting,
        around: Surroundings,
    ) -> Float[AnyArray, "... S"]:
        """Return the entries after `change` on top of `coasting`."""
        return entries + coasting + self.to_world(around.root, change)

    def difference(
        self,
        before: Float[AnyArray, "... S"],
        after: Float[AnyArray, "... S"],
        coasting: Coasting,
        root: Float[AnyArray, "... R"],
    ) -> Float[AnyArray, "... V"]:
        """Return the change by which `apply` turns `before` into `after`."""
        return self.to_body(root, after - before - coasting)

    def change_entries(self, first: int) -> list[tuple[int, ...]]:
        """Return, for each state entry, the entries of a change that affect it; the segment's own begin at `first`."""
        numbers = tuple(range(first, first + self.change_size))
        return [numbers] * self.size


@dataclass(frozen=True, kw_only=True)
class Plain(Segment):
    """Numbers changed one by one; their coasting is left to the network."""

    kind: ClassVar[str] = "plain"

    def coasting(self, state: Float[AnyArray, "... S"], dt: float) -> Coasting:
        return 0.0

    def change_entries(self, first: int) -> list[tuple[int, ...]]:
        return [(number,) for number in range(first, first + self.size)]


@dataclass(frozen=True, kw_only=True)
class _AlongRoot(Segment):
    """Vectors in the world, three numbers each, which change along the root's own axes, or those of a cloud of mass points."""

    size: int = field(default=3, init=False)

    def to_world(
        self, root: Float[AnyArray, "... 4"], change: Float[AnyArray, "... V"]
    ) -> Float[AnyArray, "... V"]:
        return flat_of(to_world_axes(root, points_of(change)))

    def to_body(
        self, root: Float[AnyArray, "... 4"], change: Float[AnyArray, "... V"]
    ) -> Float[AnyArray, "... V"]:
        return flat_of(to_body_axes(root, points_of(change)))


@dataclass(frozen=True, kw_only=True)
class Position(_AlongRoot):
    """Position of a free root; the dynamics do not depend on it."""

    kind: ClassVar[str] = "position"


@dataclass(frozen=True, kw_only=True)
class Velocity(_AlongRoot):
    """Velocity of a freely moving root, along its own axes."""

    kind: ClassVar[str] = "velocity"
    is_shown: ClassVar[bool] = True


@dataclass(frozen=True, kw_only=True)
class Quaternion(Segment):
    """An orientation, which is rotated in its own frame; the first one of a state with a `Position` is the root's."""

    kind: ClassVar[str] = "quaternion"
    size: int = field(default=4, init=False)

    @property
    def change_size(self) -> int:
        return 3

    @property
    def local_size(self) -> int:
        return 6

    def local(
        self, entries: Float[AnyArray, "... 4"], root: Float[AnyArray, "... R"], cloud: Cloud | None
    ) -> Float[AnyArray, "... 6"]:
        return two_axes(entries)

    def axes(
        self, entries: Float[AnyArray, "... 4"], cloud: Cloud | None
    ) -> Float[AnyArray, "... 4"]:
        return entries

    def apply(
        self,
        entries: Float[AnyArray, "... 4"],
        change: Float[AnyArray, "... 3"],
        coasting: Coasting,
        around: Surroundings,
    ) -> Float[AnyArray, "... 4"]:
        return rotated_by(entries, coasting + change)

    def difference(
        self,
        before: Float[AnyArray, "... 4"],
        after: Float[AnyArray, "... 4"],
        coasting: Coasting,
        root: Float[AnyArray, "... R"],
    ) -> Float[AnyArray, "... 3"]:
        return rotation_between(before, after) - coasting


@dataclass(frozen=True, kw_only=True)
class _AlongHeading(Segment):
    """A vector of a root that moves in a plane, which changes along the root's own axes."""

    size: int = field(default=2, init=False)

    def to_world(
        self, root: Float[AnyArray, "... 1"], change: Float[AnyArray, "... 2"]
    ) -> Float[AnyArray, "... 2"]:
        return rotate_in_plane(root, change)

    def to_body(
        self, root: Float[AnyArray, "... 1"], change: Float[AnyArray, "... 2"]
    ) -> Float[AnyArray, "... 2"]:
        return rotate_in_plane(-root, change)


@dataclass(frozen=True, kw_only=True)
class PlanarPosition(_AlongHeading):
    """Position of a root that moves in a plane."""

    kind: ClassVar[str] = "planar position"


@dataclass(frozen=True, kw_only=True)
class PlanarVelocity(_AlongHeading):
    """Velocity of a root that moves in a plane, along its own axes."""

    kind: ClassVar[str] = "planar velocity"
    is_shown: ClassVar[bool] = True


@dataclass(frozen=True, kw_only=True)
class Heading(Segment):
    """Heading of a root that moves in a plane [rad]."""

    kind: ClassVar[str] = "heading"
    size: int = field(default=1, init=False)

    def axes(
        self, entries: Float[AnyArray, "... 1"], cloud: Cloud | None
    ) -> Float[AnyArray, "... 1"]:
        return entries


@dataclass(frozen=True, kw_only=True)
class Points(_AlongRoot):
    """Positions of mass points, relative to their centroid; the body's axes follow from them."""

    kind: ClassVar[str] = "points"
    is_shown: ClassVar[bool] = True
    size: int

    def local(
        self, entries: Float[AnyArray, "... S"], root: Float[AnyArray, "... 4"], cloud: Cloud | None
    ) -> Float[AnyArray, "... S"]:
        points = points_of(entries)
        if cloud is not None:
            points = points - cloud.centroid(points)[..., None, :]
        return flat_of(to_body_axes(root, points))

    def axes(
        self, entries: Float[AnyArray, "... S"], cloud: Cloud | None
    ) -> Float[AnyArray, "... 4"] | None:
        if cloud is None:
            return None
        return cloud.orientation(points_of(entries))


@dataclass(frozen=True, kw_only=True)
class PointVelocities(_AlongRoot):
    """Velocities of mass points."""

    kind: ClassVar[str] = "point velocities"
    is_shown: ClassVar[bool] = True
    size: int


@dataclass(frozen=True, kw_only=True)
class _Known(Segment):
    """Numbers that are known exactly, so that their change is not predicted."""

    @property
    def change_size(self) -> int:
        return 0

    @property
    def followed(self) -> int:
        """Number of controls that it follows."""
        return self.size


@dataclass(frozen=True, kw_only=True)
class Lag(_Known):
    """Numbers that approach their controls exponentially."""

    kind: ClassVar[str] = "lag"
    time_constant: float = 0.0
    """Time in which the distance to the control falls to 1/e [s]; 0 follows at once."""

    def apply(
        self,
        entries: Float[AnyArray, "... S"],
        change: Float[AnyArray, "... 0"],
        coasting: Coasting,
        around: Surroundings,
    ) -> Float[AnyArray, "... S"]:
        if around.control is None:
            return entries
        left = 0.0
        if self.time_constant:
            left = math.exp(-around.dt / self.time_constant)
        return around.control + left * (entries - around.control)


@dataclass(frozen=True, kw_only=True)
class Driven(_Known):
    """Poses whose velocities, and angular velocities, are the controls."""

    kind: ClassVar[str] = "driven"
    quaternions: tuple[int, ...] = ()
    """Entries of its own where quaternions begin."""

    @property
    def followed(self) -> int:
        return self.size - len(self.quaternions)

    def apply(
        self,
        entries: Float[AnyArray, "... S"],
        change: Float[AnyArray, "... 0"],
        coasting: Coasting,
        around: Surroundings,
    ) -> Float[AnyArray, "... S"]:
        if around.control is None:
            return entries
        return moved(entries, around.dt * around.control, self.quaternions)


@dataclass(frozen=True, kw_only=True)
class Constant(_Known):
    """Numbers that no motion changes: the parameters of a body."""

    kind: ClassVar[str] = "constant"

    def apply(
        self,
        entries: Float[AnyArray, "... S"],
        change: Float[AnyArray, "... 0"],
        coasting: Coasting,
        around: Surroundings,
    ) -> Float[AnyArray, "... S"]:
        return entries


SEGMENTS: dict[str, type[Segment]] = {
    segment.kind: segment
    for segment in (
        Plain,
        Position,
        Quaternion,
        Velocity,
        PlanarPosition,
        Heading,
        PlanarVelocity,
        Points,
        PointVelocities,
        Lag,
        Driven,
        Constant,
    )
}
"""Kinds of segments by their names in files."""


class PlacedSegment(NamedTuple):
    """A segment and the slices of its numbers."""

    segment: Segment
    entries: slice
    """Slice of a state."""
    changes: slice
    """Slice of a change of a state."""

    @property
    def indices(self) -> range:
        """Entries of a state, one by one."""
        return range(self.entries.start, self.entries.stop)


def place_segments(segments: tuple[Segment, ...]) -> Iterator[PlacedSegment]:
    """Yield every segment of a state, in order, with its slices."""
    entry = 0
    change = 0
    for segment in segments:
        entries = slice(entry, entry + segment.size)
        changes = slice(change, change + segment.change_size)
        yield PlacedSegment(segment, entries, changes)
        entry = entries.stop
        change = changes.stop


def first_of_each(segments: tuple[Segment, ...]) -> dict[type[Segment], PlacedSegment]:
    """Return the first segment of each kind: for a freely moving root, its position, orientation and velocity."""
    firsts: dict[type[Segment], PlacedSegment] = {}
    for placed in place_segments(segments):
        firsts.setdefault(type(placed.segment), placed)
    return firsts


def moves_freely(segments: tuple[Segment, ...]) -> bool:
    """Return whether the state has a freely moving root: a position, an orientation and a velocity."""
    return {Position, Quaternion, Velocity} <= {type(segment) for segment in segments}


def orientations_of(segments: tuple[Segment, ...]) -> Pairs:
    """Return (i, j) where a quaternion begins at state entry i and its angular velocity, in its own frame, at j."""
    return tuple(
        (placed.entries.start, placed.segment.rate)
        for placed in place_segments(segments)
        if isinstance(placed.segment, Quaternion)
    )


def segments_to_json(segments: tuple[Segment, ...]) -> list[list[Any]]:
    """Return the segments as plain lists: kind, size, rate, time constant, and quaternions if there are any."""
    rows = []
    for segment in segments:
        time_constant = getattr(segment, "time_constant", 0.0)
        rows.append([segment.kind, segment.size, segment.rate, time_constant])
        if isinstance(segment, Driven) and segment.quaternions:
            rows[-1].append(list(segment.quaternions))
    return rows


def segments_from_json(rows: Any) -> tuple[Segment, ...]:
    """Return the segments `segments_to_json` wrote; ValueError if they are invalid."""
    return listed(rows, "segment", _segment_from_json, most=MAX_NUMBERS)


def _segment_from_json(row: Any, what: str) -> Segment:
    if not isinstance(row, list) or len(row) not in (4, 5):
        raise ValueError(f"{what}: wanted kind, size, rate and response, got {quoted(row)}")
    kind, size, rate, time_constant, *others = row
    whole(size, "segment: size", 1, MAX_NUMBERS)
    whole(rate, "segment: rate", -1, MAX_NUMBERS)
    number(time_constant, "segment: response", 0, MAX_RESPONSE)
    segment_class = SEGMENTS.get(kind) if isinstance(kind, str) else None
    if segment_class is Lag:
        return Lag(size=size, rate=rate, time_constant=float(time_constant))
    if segment_class is Driven and others:
        quaternions = entries(others[0], "segment: quaternions", size - 3)
        if any(after - before < 4 for before, after in pairwise(quaternions)):
            raise ValueError("segment: quaternions that overlap")
        return Driven(size=size, rate=rate, quaternions=quaternions)
    if segment_class in (Plain, Points, PointVelocities, Driven, Constant):
        return segment_class(size=size, rate=rate)
    if segment_class is not None:
        segment = segment_class(rate=rate)  # pyright: ignore[reportCallIssue]
        if segment.size == size:
            return segment
    raise ValueError(f"segment {quoted(kind)} of {size} entries is not known")
