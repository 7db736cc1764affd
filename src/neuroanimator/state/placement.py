"""The pose of a body's own frame: the state entries of its position, and of its heading or orientation."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from jaxtyping import Float

from neuroanimator.files.numbers import whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import MAX_NUMBERS
from neuroanimator.state.rotation import Rows, facing, rotation_rows


@dataclass(frozen=True)
class Placement:
    """State entries of the position and rotation of a frame; -1 for those that do not exist."""

    position: int = -1
    """First entry of its origin [m]."""
    heading: int = -1
    """Entry of its heading about Z [rad]."""
    orientation: int = -1
    """First entry of its quaternion."""

    def to_json(self) -> dict[str, int]:
        """Return the entries by name."""
        return asdict(self)

    @classmethod
    def from_json(cls, described: Any) -> Placement:
        """Return the placement that `to_json` wrote; ValueError for what is no entry."""
        names = ("position", "heading", "orientation")
        return cls(*(whole(described[name], f"shapes: {name}", -1, MAX_NUMBERS) for name in names))

    def origin(self, states: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 3"]:
        """Return the position of the frame [m]."""
        if self.position < 0:
            return states.__array_namespace__().zeros_like(states[..., :3])
        return states[..., self.position : self.position + 3]

    def rows(self, states: Float[AnyArray, "*B S"]) -> Rows | None:
        """Return the nine entries (...) of the rotation to the world; None for a frame that does not turn."""
        if self.orientation >= 0:
            return rotation_rows(states[..., self.orientation : self.orientation + 4])
        if self.heading >= 0:
            return heading_rows(states[..., self.heading])
        return None

    def quaternions(self, states: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 4"] | None:
        """Return the quaternions of the frame; None if it does not turn."""
        if self.orientation >= 0:
            return states[..., self.orientation : self.orientation + 4]
        if self.heading >= 0:
            return facing(states[..., self.heading])
        return None

    def to_world(
        self, states: Float[AnyArray, "*B S"], points: Float[AnyArray, "*B N 3"]
    ) -> Float[AnyArray, "*B N 3"]:
        """Return the world positions of points of the frame [m]."""
        turned = turn(self.rows(states), points)
        return turned + self.origin(states)[..., None, :]


def heading_rows(heading: Float[AnyArray, " *B"]) -> Rows:
    """Return the nine entries (...) of a rotation about Z by `heading` [rad]."""
    xp = heading.__array_namespace__()
    cosine = xp.cos(heading)
    sine = xp.sin(heading)
    zero = xp.zeros_like(heading)
    one = xp.ones_like(heading)
    return ((cosine, -sine, zero), (sine, cosine, zero), (zero, zero, one))


def turn(rows: Rows | None, vectors: Float[AnyArray, "*B N 3"]) -> Float[AnyArray, "*B N 3"]:
    """Return `vectors` (..., N, 3) turned by the rotation whose entries are (...)."""
    if rows is None:
        return vectors
    turned = []
    for row in rows:
        turned.append(sum(entry[..., None] * vectors[..., axis] for axis, entry in enumerate(row)))
    return vectors.__array_namespace__().stack(turned, axis=-1)


def turn_back(rows: Rows | None, vectors: Float[AnyArray, "*B N 3"]) -> Float[AnyArray, "*B N 3"]:
    """Return `vectors` (..., N, 3) turned by the inverse of the rotation whose entries are (...)."""
    if rows is None:
        return vectors
    columns: Rows = tuple((rows[0][k], rows[1][k], rows[2][k]) for k in range(3))
    return turn(columns, vectors)
