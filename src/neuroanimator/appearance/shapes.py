"""A surface of thousands of nodes in few numbers: a mean, and shapes added to it, each times its amplitude.

An emulator carries both in few bits, so that its motions are drawn without physics; its states hold the amplitudes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.appearance.loft import Surface, normals_of
from neuroanimator.files.atomic import Tensors
from neuroanimator.state.placement import Placement

BACK = (0.21, 0.28, 0.31)
"""Red, green and blue of a solid that moves freely, where it faces up at rest."""

BELLY = (0.87, 0.88, 0.84)
"""The same, where it faces down."""

EDGE = 0.4
"""Vertical component of normals at which back and belly are pure; between them colours are mixed."""

MAX_NODES = 100_000
"""Maximum number of nodes of a surface: it may come from a stranger, and is drawn."""

MAX_SHAPES = 256
"""Maximum number of shapes."""

LARGEST = 2**15 - 1
"""Largest signed 16-bit integer."""

MAX_FINE = 2**7 - 1
"""Largest signed 8-bit integer."""

COARSE_MODES = 16
"""Number of modes kept in 16 bits: later ones move nodes by a few percent of the body's size, and are kept in 8."""

MAX_DISTANCE = 1e6
"""Largest coordinate drawn [m]."""

TENSORS = ("mean", "modes", "fine_modes", "scales", "faces")
"""Names of the arrays of a file's shapes."""


def flesh_colours(shades: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 3"]:
    """Return the colours (sRGB) of flesh from its belly, shade 0, to its back, shade 1."""
    return BELLY + shades[:, None] * np.subtract(BACK, BELLY)


@dataclass(frozen=True, eq=False)
class Shapes:
    """N nodes whose positions a state gives by K amplitudes."""

    mean: Float[np.ndarray, "N 3"]
    """Positions of the nodes in the anchor's frame at zero amplitudes [m]."""
    modes: Float[np.ndarray, "K N 3"]
    """Displacement of the nodes by each amplitude; modes are orthogonal, each of root mean square 1 a node."""
    faces: Int[np.ndarray, "F 3"]
    """Corners of the triangles, counterclockwise from outside."""
    first: int
    """State entry of the first amplitude [m, root mean square a node]."""
    placement: Placement
    """State entries of the frame that all nodes move and turn with: the anchor's."""
    rgba: ClassVar[tuple[float, float, float, float]] = (0.74, 0.25, 0.21, 1.0)
    """Red, green, blue (sRGB) and opacity of a cloth, and of a solid that is held."""

    @cached_property
    def digest(self) -> str:
        """Hash of everything in the shapes: two that are equal in a file are equal."""
        content = hashlib.sha256(f"{self.first} {self.placement}".encode())
        for array in self.tensors().values():
            content.update(array.tobytes())
        return content.hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Shapes) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    @cached_property
    def shades(self) -> Float[np.ndarray, " N"] | None:
        """Shade of each node of a solid that moves freely, for `flesh_colours`; others are `rgba` all over."""
        if self.placement.orientation < 0:
            return None
        up = normals_of(Surface(self.mean, self.faces))[:, 2]
        return np.clip(up / EDGE + 1, 0, 2) / 2

    @property
    def colours(self) -> Float[np.ndarray, "N 3"] | None:
        """Red, green and blue (sRGB) of each node that has a shade."""
        return None if self.shades is None else flesh_colours(self.shades)

    @property
    def amplitudes(self) -> slice:
        """State entries of the amplitudes."""
        return slice(self.first, self.first + len(self.modes))

    def decode(
        self, states: Float[np.ndarray, "*B S"], nodes: Any = slice(None)
    ) -> Float[np.ndarray, "*B n 3"]:
        """Return the positions of nodes [m], all or those numbered; the cost is proportional to their number."""
        return self.placement.to_world(states, self.unplaced(states, nodes))

    def unplaced(
        self, states: Float[np.ndarray, "*B S"], nodes: Any = slice(None)
    ) -> Float[np.ndarray, "*B n 3"]:
        """Return the positions of nodes in the anchor's frame [m]."""
        modes = self.modes[:, nodes]
        return self.mean[nodes] + np.tensordot(states[..., self.amplitudes], modes, axes=1)

    def project(self, vectors: Float[np.ndarray, "*B N 3"]) -> Float[np.ndarray, "*B K"]:
        """Return the amplitudes, or their rates, of displacements [m], or velocities [m/s], of all nodes."""
        along = np.tensordot(vectors, self.modes, axes=((-2, -1), (1, 2))) / len(self.mean)
        return along @ self._inverse_overlaps

    @cached_property
    def _inverse_overlaps(self) -> Float[np.ndarray, "K K"]:
        """Inverse of the modes' products with each other: nearly the identity, as modes are rounded."""
        rows = self.modes.reshape(len(self.modes), -1)
        return np.linalg.inv(rows @ rows.T / len(self.mean))

    def tensors(self) -> Tensors:
        """Return the arrays as files hold them: modes as 16-bit and 8-bit integers, each in units of its own scale."""
        largest = np.full(len(self.modes), LARGEST)
        largest[COARSE_MODES:] = MAX_FINE
        scales = np.abs(self.modes).max(axis=(1, 2)) / largest
        whole = np.round(self.modes / scales[:, None, None])
        return {
            "mean": self.mean.astype(np.float32),
            "modes": whole[:COARSE_MODES].astype(np.int16),
            "fine_modes": whole[COARSE_MODES:].astype(np.int8),
            "scales": scales.astype(np.float32),
            "faces": self.faces.astype(np.int32),
        }

    @classmethod
    def from_tensors(
        cls, tensors: Mapping[str, np.ndarray], first: int, placement: Placement, state_size: int
    ) -> Shapes:
        """Return the shapes `tensors` wrote; ValueError names what is wrong with them."""
        if set(tensors) != set(TENSORS):
            raise ValueError(f"shapes: wanted {', '.join(TENSORS)}")
        mean, modes, fine_modes, scales, faces = (tensors[name] for name in TENSORS)
        nodes = len(mean) if mean.ndim else 0
        count = len(scales) if scales.ndim else 0
        coarse = min(count, COARSE_MODES)
        wanted = {
            "mean": ((nodes, 3), np.float32),
            "modes": ((coarse, nodes, 3), np.int16),
            "fine_modes": ((count - coarse, nodes, 3), np.int8),
            "scales": ((count,), np.float32),
        }
        for name, (shape, dtype) in wanted.items():
            if tensors[name].shape != shape or tensors[name].dtype != dtype:
                raise ValueError(f"shapes: '{name}' has the wrong shape or type of number")
        if not 3 <= nodes <= MAX_NODES or not 1 <= count <= MAX_SHAPES:
            raise ValueError(f"shapes: {count} shapes of {nodes} nodes")
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype != np.int32:
            raise ValueError("shapes: wanted faces of three nodes")
        if len(faces) and not (faces.min() >= 0 and faces.max() < nodes):
            raise ValueError("shapes: a face names a node that does not exist")
        if not (np.abs(mean) <= MAX_DISTANCE).all() or not (scales > 0).all():
            raise ValueError("shapes: wanted finite positions, and scales above 0")
        if not (scales * LARGEST <= MAX_DISTANCE).all():
            raise ValueError("shapes: a scale is too large")
        ends = (placement.position + 3, placement.heading + 1, placement.orientation + 4)
        if max(ends) > state_size or not 0 <= first <= state_size - count:
            raise ValueError("shapes: they read beyond the state")
        whole = np.concatenate([modes, fine_modes]) * scales[:, None, None]
        return cls(mean.astype(float), whole.astype(float), faces.astype(int), first, placement)
