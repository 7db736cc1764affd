"""The pose of a body's own frame: the state entries of its position, and of its heading or orientation."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from jaxtyping import Float

from neuroanimator.files.numbers import whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import MAX_NUMBERS
from neuroanimator.state.rotation import facing, to_world_axes


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
        return self.turned(states, points) + self.origin(states)[..., None, :]

    def turned(
        self, states: Float[AnyArray, "*B S"], vectors: Float[AnyArray, "*B N 3"]
    ) -> Float[AnyArray, "*B N 3"]:
        """Return vectors of the frame along the world's axes."""
        quaternions = self.quaternions(states)
        if quaternions is None:
            return vectors
        return to_world_axes(quaternions, vectors)
