"""Contacts of a body: points of it that may touch the ground, and joints that may reach their stops. A contact is a
kink in the motion, and its time within the super step decides the outcome. With heights and approaches, now and after
coasting, as features, a network need not learn the kinematics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from neuroanimator.files.numbers import entries, listed, numbers
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.kinematics import Kinematics, product
from neuroanimator.state.layout import Pairs
from neuroanimator.state.rotation import conjugate, rotated_by, rotation_matrices

CEILING = 1.0
"""Height [m] around which features saturate: no super step falls from above it to the ground."""

GROUND_SOFTNESS = 0.05
"""Length [m] over which the kink of a depth is rounded: about the indentation of soft ground."""

STOP_SOFTNESS = 0.1
"""Angle [rad], or length [m], over which the kink at a joint's stop is rounded."""

MAX_POINTS = 64
"""Maximum number of points that may touch the ground: each has several features."""

MAX_PLANES = 8
"""Maximum number of planes they may touch."""

MAX_STOPS = 500
"""Maximum number of joints with stops."""

UNIT_TOLERANCE = 1e-3
"""Tolerance of the length of a plane's normal read from a file, which should be 1."""

MAX_DISTANCE = 1e6
"""Largest coordinate of a point or a plane [m], and largest end of a joint's range [rad or m]."""


T = TypeVar("T")
"""Type of a list's entries."""


class ContactPoint(NamedTuple):
    """A ball fixed to a link, which may touch the ground."""

    link: int
    x: float
    y: float
    z: float
    radius: float


class Plane(NamedTuple):
    """The ground: all points whose dot product with the unit normal is `offset` [m]; the body is above it."""

    x: float
    y: float
    z: float
    offset: float


class JointStop(NamedTuple):
    """The range of a joint: it is held between `low` and `high` [rad or m]."""

    entry: int
    """State entry of the joint."""
    low: float
    high: float


@dataclass(frozen=True)
class Contacts:
    """Features of possible contacts, by the kinematics of the body."""

    kinematics: Kinematics
    points: tuple[ContactPoint, ...]
    """Contact points, in the order of the frames that carry them: see `in_order`."""
    planes: tuple[Plane, ...]
    stops: tuple[JointStop, ...]
    axes: tuple[int, ...]
    """Axes x, y, z along which the points move at all."""
    placeless: tuple[int, ...]
    """State entries of the body's position where it does not matter: they are replaced by zeros."""
    rates: Pairs
    """(i, j) where state entry j is the rate of entry i."""
    orientations: Pairs
    """(i, j) where a quaternion begins at state entry i and its angular velocity, in its own frame, at j."""

    @property
    def size(self) -> int:
        """Length of the result of `shown`."""
        heights = 4 * len(self.points) * len(self.planes)
        return heights + len(self.points) * len(self.axes) + 2 * len(self.stops)

    def shown(
        self, state: Float[AnyArray, "... S"], root: Float[AnyArray, "... R"], dt: float
    ) -> list[Float[AnyArray, "... _"]]:
        """Return the features of a state (..., S) for a network, in pieces.

        For points: their heights over the planes and depths in them, now and after coasting for `dt` [s], and the
        displacement between, along the axes of `root` if it is a quaternion (R = 4). For stops: the angles or distances by
        which joints are past them, now and after coasting.
        """
        shown = []
        if self.points:
            place = self._without_place(state)
            both = state.__array_namespace__().stack([place, self.coasted(place, dt)], axis=-2)
            centres = self.centres(both)
            now = centres[..., 0, :, :]
            later = centres[..., 1, :, :]
            heights = self.heights(centres)
            for when in (0, 1):
                height = heights[..., when, :]
                shown += [below_ceiling(height), depth(height, GROUND_SOFTNESS)]
            shown.append(self._way(later - now, root))
        if self.stops:
            shown += self._past_stops(state, dt)
        return shown

    def _without_place(self, state: Float[AnyArray, "... S"]) -> Float[AnyArray, "... S"]:
        """Return `state` with zeros at `placeless` entries: differences of positions keep all their digits."""
        matters = np.ones(state.shape[-1])
        matters[list(self.placeless)] = 0.0
        return state * state.__array_namespace__().asarray(matters, dtype=state.dtype)

    def coasted(self, state: Float[AnyArray, "... S"], dt: float) -> Float[AnyArray, "... S"]:
        """Return `state` (..., S) with its positions after `dt` [s] at its rates."""
        xp = state.__array_namespace__()
        size = state.shape[-1]
        coasting = np.zeros((size, size))
        for position, rate in self.rates:
            coasting[rate, position] = dt
        coasted = state + state @ xp.asarray(coasting, dtype=state.dtype)
        for first, rate in self.orientations:
            turning = dt * state[..., rate : rate + 3]
            orientation = rotated_by(state[..., first : first + 4], turning)
            rest = coasted[..., first + 4 :]
            coasted = xp.concat([coasted[..., :first], orientation, rest], axis=-1)
        return coasted

    def centres(self, state: Float[AnyArray, "... S"]) -> Float[AnyArray, "... 3 P"]:
        """Return the centres of the points in the world [m], of states (..., S)."""
        xp = state.__array_namespace__()
        transforms = self.kinematics.transforms(state)
        centres = []
        for frame, offsets in self._offsets:
            upper = transforms[frame][..., :3, :]
            centres.append(product(upper, xp.asarray(offsets, dtype=state.dtype)))
        return xp.concat(centres, axis=-1)

    @cached_property
    def _offsets(self) -> list[tuple[int, Float[np.ndarray, "4 K"]]]:
        """The points by the frame that carries them, as homogeneous columns."""
        by_frame: dict[int, list[Float[np.ndarray, " 4"]]] = {}
        for point in self.points:
            carried = self.kinematics.carried[point.link]
            offset = carried.matrix @ [point.x, point.y, point.z, 1.0]
            by_frame.setdefault(carried.frame, []).append(offset)
        return [(frame, np.stack(offsets, axis=1)) for frame, offsets in by_frame.items()]

    def heights(self, centres: Float[AnyArray, "... 3 P"]) -> Float[AnyArray, "... PG"]:
        """Return the heights of the points at `centres` over each plane [m], those over the first plane first."""
        xp = centres.__array_namespace__()
        radii = np.array([point.radius for point in self.points])
        heights = []
        for plane in self.planes:
            normal = xp.asarray(np.array(plane[:3])[:, None], dtype=centres.dtype)
            lowest = xp.asarray(plane.offset + radii, dtype=centres.dtype)
            heights.append(xp.sum(normal * centres, axis=-2) - lowest)
        return xp.concat(heights, axis=-1)

    def _way(
        self, way: Float[AnyArray, "... 3 P"], root: Float[AnyArray, "... R"]
    ) -> Float[AnyArray, "... PA"]:
        """Return the points' displacements [m] along the axes on which they move, the root's own if it is a quaternion."""
        xp = way.__array_namespace__()
        if root.shape[-1] == 4:
            way = product(rotation_matrices(conjugate(root)), way)
        return xp.concat([way[..., axis, :] for axis in self.axes], axis=-1)

    def _past_stops(
        self, state: Float[AnyArray, "... S"], dt: float
    ) -> list[Float[AnyArray, "... L"]]:
        """Return how far joints are past their stops, now and after coasting: positive below the lower one, negative above
        the upper one."""
        xp = state.__array_namespace__()
        rates = dict(self.rates)
        low = xp.asarray(np.array([stop.low for stop in self.stops]), dtype=state.dtype)
        high = xp.asarray(np.array([stop.high for stop in self.stops]), dtype=state.dtype)
        now = xp.stack([state[..., stop.entry] for stop in self.stops], axis=-1)
        rate = xp.stack([state[..., rates[stop.entry]] for stop in self.stops], axis=-1)
        shown = []
        for value in (now, now + dt * rate):
            shown.append(depth(value - low, STOP_SOFTNESS) - depth(high - value, STOP_SOFTNESS))
        return shown

    def to_json(self) -> dict[str, Any]:
        """Return the parts that do not follow from the skeleton and the state, as plain lists."""
        return {
            "points": [list(point) for point in self.points],
            "planes": [list(plane) for plane in self.planes],
            "stops": [list(stop) for stop in self.stops],
            "axes": list(self.axes),
            "placeless": list(self.placeless),
        }

    @classmethod
    def from_json(
        cls,
        described: Any,
        *,
        kinematics: Kinematics,
        rates: Pairs,
        orientations: Pairs,
        state_size: int,
    ) -> Contacts:
        """Return the contacts `to_json` wrote of a body with these kinematics; ValueError names the fault."""

        def point(row: Any, what: str) -> ContactPoint:
            link, x, y, z, radius = numbers(row, what, 5, MAX_DISTANCE)
            if link not in range(len(kinematics.links)):
                raise ValueError(f"{what}: on a bone that does not exist")
            return ContactPoint(int(link), x, y, z, radius)

        def plane(row: Any, what: str) -> Plane:
            found = Plane(*numbers(row, what, 4, MAX_DISTANCE))
            if abs(np.linalg.norm(found[:3]) - 1) > UNIT_TOLERANCE:
                raise ValueError(f"{what}: wanted a normal of length 1")
            return found

        def stop(row: Any, what: str) -> JointStop:
            entry, low, high = numbers(row, what, 3, MAX_DISTANCE)
            if entry not in dict(rates) or low > high:
                raise ValueError(f"{what}: wanted a joint with a rate, and its range")
            return JointStop(int(entry), low, high)

        points = _at_most(described["points"], "contacts: points", point, MAX_POINTS)
        if points != in_order(points, kinematics):
            raise ValueError("contacts: points out of order")
        contacts = cls(
            kinematics=kinematics,
            points=points,
            planes=_at_most(described["planes"], "contacts: planes", plane, MAX_PLANES),
            stops=_at_most(described["stops"], "contacts: stops", stop, MAX_STOPS),
            axes=entries(described["axes"], "contacts: axes", 3),
            placeless=entries(described["placeless"], "contacts: placeless", state_size),
            rates=rates,
            orientations=orientations,
        )
        if contacts.points and not contacts.planes:
            raise ValueError("contacts: points without a plane")
        if not {*contacts.placeless} <= {position for position, _ in rates}:
            raise ValueError("contacts: placeless entries without a rate")
        return contacts


def in_order(points: Iterable[ContactPoint], kinematics: Kinematics) -> tuple[ContactPoint, ...]:
    """Return the points that move, in the order of the frames that carry them."""
    moving = [point for point in points if kinematics.carried[point.link].frame >= 0]
    return tuple(sorted(moving, key=lambda point: kinematics.carried[point.link].frame))


def _at_most(rows: Any, what: str, read: Callable[[Any, str], T], most: int) -> tuple[T, ...]:
    found = listed(rows, what, read)
    if len(found) > most:
        raise ValueError(f"{what}: wanted at most {most}, got {len(found)}")
    return found


# Square roots instead of tanh and softplus: those compile to scalar code that takes half the time of a super step.


def below_ceiling(height: Float[AnyArray, " ..."]) -> Float[AnyArray, " ..."]:
    """Return `height` [m] where it is small, the ceiling where it is large."""
    xp = height.__array_namespace__()
    return height / xp.sqrt(1 + (height / CEILING) ** 2)


def height_below_ceiling(shown: Float[AnyArray, " ..."]) -> Float[AnyArray, " ..."]:
    """Return the height [m] for which `below_ceiling` is `shown`."""
    xp = shown.__array_namespace__()
    return shown / xp.sqrt(1 - (shown / CEILING) ** 2)


def depth(height: Float[AnyArray, " ..."], softness: float) -> Float[AnyArray, " ..."]:
    """Return how far below zero `height` is, its kink rounded over `softness`, at most the ceiling."""
    xp = height.__array_namespace__()
    near = xp.clip(height, -CEILING, CEILING)
    # (root - near) / 2; high above, where the two are nearly equal, as a quotient.
    half = (xp.sqrt(near * near + softness**2) + xp.abs(near)) / 2
    return xp.where(near > 0, softness**2 / 4 / half, half)
