"""How a state looks: a tree of hinged bones, drawn as capsules. Needs no physics engine."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Bone:
    """One rigid body, turned about a hinge at its origin."""

    name: str
    parent: int
    """Index of the bone it hangs from; -1 for the world."""
    offset: Numbers
    """Its hinge in the parent's frame [m]."""
    axis: Numbers
    """Unit axis of the hinge, in its own frame."""
    angle: int
    """State entry that holds the hinge's angle [rad]."""
    start: Numbers
    """One end of the capsule that draws it, in its own frame [m]."""
    end: Numbers
    radius: float
    """[m]"""
    colour: Numbers
    """Red, green, blue, opacity, each 0 to 1."""


@dataclass(frozen=True)
class Skeleton:
    """Bones in order, each after its parent."""

    bones: tuple[Bone, ...]

    def local_rotations(self, states: np.ndarray) -> np.ndarray:
        """Return each bone's quaternion wxyz (T, B, 4) in its parent's frame, for states (T, S)."""
        angles = np.stack([states[:, bone.angle] for bone in self.bones], axis=1) / 2
        axes = np.array([bone.axis for bone in self.bones])
        return np.concatenate([np.cos(angles)[..., None], np.sin(angles)[..., None] * axes], axis=-1)

    def world_points(self, states: np.ndarray) -> np.ndarray:
        """Return each bone's capsule ends (T, B, 2, 3) in the world [m]."""
        rotations = rotation_matrices(self.local_rotations(states))
        turns: list[np.ndarray] = []
        origins: list[np.ndarray] = []
        points = []
        for i, bone in enumerate(self.bones):
            turn, origin = np.broadcast_to(np.eye(3), (len(states), 3, 3)), np.zeros((len(states), 3))
            if bone.parent >= 0:
                turn, origin = turns[bone.parent], origins[bone.parent]
            origins.append(origin + turn @ np.array(bone.offset))
            turns.append(turn @ rotations[:, i])
            points.append(np.stack([origins[i] + turns[i] @ np.array(end) for end in (bone.start, bone.end)], axis=1))
        return np.stack(points, axis=1)

    def to_json(self) -> list[dict[str, Any]]:
        """Return plain dictionaries, one per bone."""
        return [asdict(bone) for bone in self.bones]

    @classmethod
    def from_json(cls, rows: list[dict[str, Any]]) -> Skeleton:
        """Return the skeleton `to_json` wrote."""
        if any({*row} != {field.name for field in fields(Bone)} for row in rows):
            raise ValueError("skeleton: a bone has other fields than expected")
        fixed: list[dict[str, Any]] = [
            {key: tuple(value) if isinstance(value, list) else value for key, value in row.items()} for row in rows
        ]
        return cls(tuple(Bone(**row) for row in fixed))


def rotation_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Return the matrices (..., 3, 3) of unit quaternions wxyz (..., 4)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
