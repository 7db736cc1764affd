"""Contacts of a soft body, as its emulator is shown them: how near sampled nodes will be to what moves.

The state holds positions of movers, their velocities, amplitudes of shapes and their rates. Nodes are looked at where
they would coast to, and movers where they will be: their velocities are the controls.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.files.numbers import entries, listed, number, numbers, whole
from neuroanimator.state.arrays import AnyArray

MAX_NODES = 256
"""Maximum number of sampled nodes: each is four features a collider."""

MAX_COLLIDERS = 64
"""Maximum number of colliders."""

MAX_MOVERS = 64
"""Maximum number of movers."""

MAX_DISTANCE = 1e6
"""Largest coordinate, radius or reach [m]."""

ROUNDS = 4
"""Times that nodes are pushed out of each collider: out of one, a node may come into another."""

TINY = 1e-9
"""Added to squares of lengths [m²] before their root is divided by."""


class Collider(NamedTuple):
    """A capsule that goes with a mover; of no length, a sphere."""

    mover: int
    start: tuple[float, ...]
    """From the mover's position [m]."""
    along: tuple[float, ...]
    """From its start to its end [m]."""
    radius: float
    """[m]"""


@dataclass(frozen=True, eq=False)
class ShapeContacts:
    """Features of the contacts that may come in a super step, of P nodes and K shapes."""

    movers: int
    """Number of movers: their positions, then their velocities, begin the state; then come amplitudes, then rates."""
    anchor: int
    """Number of the mover that all nodes go with; -1 if there is none."""
    colliders: tuple[Collider, ...]
    reach: float
    """Distance from a collider's surface at which it begins to show [m]."""
    nodes: tuple[int, ...]
    """Numbers of the sampled nodes."""
    mean: Float[np.ndarray, "P 3"] = field(repr=False)
    """Positions of the nodes from the anchor, with no amplitudes [m]."""
    modes: Float[np.ndarray, "K P 3"] = field(repr=False)
    """Displacement of the nodes by each amplitude."""
    digest: str = field(init=False)
    """Hash of the arrays, so that its text names what is compiled for it."""

    def __post_init__(self) -> None:
        content = self.mean.astype(np.float32).tobytes() + self.modes.astype(np.float32).tobytes()
        object.__setattr__(self, "digest", hashlib.sha256(content).hexdigest())

    @property
    def size(self) -> int:
        """Length of all that `shown` returns."""
        others = self.movers - (self.anchor >= 0)
        return 3 * others + 4 * len(self.nodes) * len(self.colliders)

    def shown(
        self, state: Float[AnyArray, "... S"], control: Float[AnyArray, "... C"], dt: float
    ) -> list[Float[AnyArray, "... _"]]:
        """Return pieces of what a network is shown of a state (..., S) and the movers' velocities (..., C).

        Where movers are from the anchor; then, for each collider, how near the nodes come (0 from `reach` on, 1 at the
        surface, more in it) after `dt` [s], and that times the direction away from it.
        """
        shown = []
        for mover in range(self.movers):
            if mover != self.anchor:
                shown.append(self._from_anchor(state, mover))
        nodes = self._nodes_later(state, dt)
        end = state[..., : 3 * self.movers] + dt * control
        for collider in self.colliders:
            mover = self._from_anchor(end, collider.mover)
            shown += self._nearness(nodes, mover, collider)
        return shown

    def _from_anchor(
        self, positions: Float[AnyArray, "... _"], mover: int
    ) -> Float[AnyArray, "... 3"]:
        """Return where a mover is from the anchor [m]."""
        own = positions[..., 3 * mover : 3 * mover + 3]
        if self.anchor < 0:
            return own
        return own - positions[..., 3 * self.anchor : 3 * self.anchor + 3]

    @cached_property
    def _rows(self) -> tuple[Float[np.ndarray, "K X"], Float[np.ndarray, " X"]]:
        """Modes and mean, axis by axis: x of all nodes, y of all, z of all."""
        modes = np.moveaxis(self.modes, 1, 2).reshape(len(self.modes), -1)
        return modes.astype(np.float32), self.mean.T.ravel().astype(np.float32)

    def _nodes_later(
        self, state: Float[AnyArray, "... S"], dt: float
    ) -> list[Float[AnyArray, "... P"]]:
        """Return x, y and z of the nodes from the anchor [m] after `dt` [s] at the present rates."""
        xp = state.__array_namespace__()
        count = len(self.modes)
        first = 6 * self.movers
        amplitudes = state[..., first : first + count]
        rates = state[..., first + count : first + 2 * count]
        modes, mean = self._rows
        placed = (amplitudes + dt * rates) @ xp.asarray(modes, dtype=state.dtype)
        placed = placed + xp.asarray(mean, dtype=state.dtype)
        size = len(self.nodes)
        return [placed[..., axis * size : (axis + 1) * size] for axis in range(3)]

    def _nearness(
        self,
        nodes: list[Float[AnyArray, "... P"]],
        mover: Float[AnyArray, "... 3"],
        collider: Collider,
    ) -> list[Float[AnyArray, "... P"]]:
        xp = mover.__array_namespace__()
        away = _from_axis(nodes, mover, collider)
        distance = _length(away)
        near = xp.maximum(1 - (distance - collider.radius) / self.reach, xp.zeros_like(distance))
        weight = near / distance
        return [near, *(weight * gap for gap in away)]

    def pushed_out(
        self, points: Float[AnyArray, "... N 3"], states: Float[AnyArray, "... S"]
    ) -> Float[AnyArray, "... N 3"]:
        """Return any nodes at `points` [m] of the world, those inside of colliders brought to where their surface is."""
        xp = points.__array_namespace__()
        nodes = [points[..., axis] for axis in range(3)]
        for _ in range(ROUNDS):
            for collider in self.colliders:
                first = 3 * collider.mover
                away = _from_axis(nodes, states[..., first : first + 3], collider)
                distance = _length(away)
                depth = xp.maximum(collider.radius - distance, xp.zeros_like(distance))
                push = depth / distance
                nodes = [node + push * gap for node, gap in zip(nodes, away, strict=True)]
        return xp.stack(nodes, axis=-1)

    def to_json(self) -> dict[str, Any]:
        """Return all but the arrays, which follow from the shapes and the nodes' numbers."""
        colliders = [[one.mover, *one.start, *one.along, one.radius] for one in self.colliders]
        return {
            "movers": self.movers,
            "anchor": self.anchor,
            "colliders": colliders,
            "reach": self.reach,
            "nodes": list(self.nodes),
        }

    @classmethod
    def from_json(
        cls,
        described: Any,
        mean: Float[np.ndarray, "N 3"],
        modes: Float[np.ndarray, "K N 3"],
        state_size: int,
        controls: int,
    ) -> ShapeContacts:
        """Return what `to_json` wrote, of a body with this mean and these modes; ValueError says what none has."""
        movers = whole(described["movers"], "shape contacts: movers", 1, MAX_MOVERS)
        if controls != 3 * movers or state_size != 6 * movers + 2 * len(modes):
            raise ValueError("shape contacts: other movers or shapes than the state's")

        def collider(row: Any, what: str) -> Collider:
            mover, *places, radius = numbers(row, what, 8, MAX_DISTANCE)
            if mover not in range(movers):
                raise ValueError(f"{what}: of a mover that is not there")
            return Collider(int(mover), tuple(places[:3]), tuple(places[3:]), radius)

        colliders = listed(described["colliders"], "shape contacts: colliders", collider)
        nodes = entries(described["nodes"], "shape contacts: nodes", len(mean))
        if len(colliders) > MAX_COLLIDERS or not 1 <= len(nodes) <= MAX_NODES:
            raise ValueError("shape contacts: too many colliders or nodes, or no node")
        return cls(
            movers=movers,
            anchor=whole(described["anchor"], "shape contacts: anchor", -1, movers - 1),
            colliders=colliders,
            reach=number(described["reach"], "shape contacts: reach", 1e-6, MAX_DISTANCE),
            nodes=nodes,
            mean=mean[list(nodes)],
            modes=modes[:, list(nodes)],
        )


def _from_axis(
    nodes: list[Float[AnyArray, "... P"]], mover: Float[AnyArray, "... 3"], collider: Collider
) -> list[Float[AnyArray, "... P"]]:
    """Return x, y and z of nodes from the nearest point of the collider's axis [m]; they and its mover in one frame."""
    xp = mover.__array_namespace__()
    away = []
    for axis in range(3):
        start = mover[..., axis : axis + 1] + collider.start[axis]
        away.append(nodes[axis] - start)
    square = sum(length * length for length in collider.along)
    if square > 0:
        share = sum(along * gap for along, gap in zip(collider.along, away, strict=True))
        share = xp.clip(share / square, 0.0, 1.0)
        away = [gap - along * share for along, gap in zip(collider.along, away, strict=True)]
    return away


def _length(vector: list[Float[AnyArray, "... P"]]) -> Float[AnyArray, "... P"]:
    x, y, z = vector
    return x.__array_namespace__().sqrt(x * x + y * y + z * z + TINY)
