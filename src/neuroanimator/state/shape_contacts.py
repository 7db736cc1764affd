"""Contacts of a soft body, as features of its emulator: the nearness of sampled nodes to what they may touch.

With M movers, some of which turn, and K shapes, a state is

    movers' poses | their rates | root of a free body | amplitudes of the shapes | their rates | parameters

Shapes are in the body's own frame, which moves and turns with the mover that holds the body, its anchor, or with the
root of a body that nothing holds. All features are in that frame, so that moving and turning the world changes nothing.
Nodes are taken where they would coast to, and movers where they will be: the controls are their rates.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from neuroanimator.files.numbers import entries, flag, listed, number, numbers, whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.mover_poses import (
    FREELY,
    Mover,
    Turns,
    moved,
    place_movers,
    quaternion_entries,
)
from neuroanimator.state.placement import Placement
from neuroanimator.state.rotation import NO_ROTATION, rotate, rotate_back, rotated_by

MAX_NODES = 256
"""Maximum number of sampled nodes: each has four features."""

MAX_COLLIDERS = 64
"""Maximum number of colliders."""

MAX_MOVERS = 64
"""Maximum number of movers."""

MAX_DISTANCE = 1e6
"""Largest coordinate, radius or reach [m]."""

ROUNDS = 8
"""Number of times that nodes are pushed out of the deepest collider: out of one, a node may enter another."""

AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""The unit vectors along the axes of a frame."""

TINY = 1e-9
"""Square of a length [m²] added under square roots that are divided by."""

FREE = -1
"""Anchor of a body that nothing holds."""

HELD = -2
"""Anchor of a body held by the world: its own frame is the world's."""

ROOT = 13
"""Number of entries of a free body's root: position, quaternion, velocity and angular velocity in its own axes."""

Distances = Float[AnyArray, "... P"]
"""A distance or a coordinate of each of P points [m]."""

Coordinates = list[Distances]
"""Three coordinates of points, or of directions."""

Surface = tuple[Distances, Coordinates]
"""Distances of points from a surface [m], and the directions away from it."""

Point = tuple[float, ...]
"""Three coordinates in a mover's frame [m]."""


class RoundCollider(NamedTuple):
    """A capsule that moves with a mover; a sphere if its length is zero."""

    mover: int
    start: Point
    along: Point
    """Vector from its start to its end [m]."""
    radius: float
    """Radius [m]."""
    friction: float = 0.4
    """Largest sideways force over the normal one."""

    @property
    def is_round(self) -> bool:
        """Whether its mover's rotation does not matter."""
        return not any((*self.start[:2], *self.along[:2]))


class BoxCollider(NamedTuple):
    """A box that moves with a mover, its edges along the mover's axes."""

    mover: int
    centre: Point
    half: Point
    """Half its size along each axis [m]."""
    radius: float = 0.0
    """Radius by which it is rounded outwards [m]."""
    friction: float = 0.4
    """Largest sideways force over the normal one."""


AnyCollider = TypeVar("AnyCollider", RoundCollider, BoxCollider)


def first_after_movers(turning: tuple[Turns, ...]) -> int:
    """Return the state entry after those of movers' poses and rates."""
    return sum(mover.size + mover.rate_size for mover in place_movers(turning))


def first_amplitude(turning: tuple[Turns, ...], anchor: int) -> int:
    """Return the state entry of the first amplitude, after those of movers, and of a free root if `anchor` is `FREE`."""
    return first_after_movers(turning) + (ROOT if anchor == FREE else 0)


def placement_of(turning: tuple[Turns, ...], anchor: int) -> Placement:
    """Return the state entries of the body's own frame: of the anchor, or of a free root if that is `FREE`."""
    if anchor == HELD:
        return Placement()
    if anchor == FREE:
        root = first_after_movers(turning)
        return Placement(position=root, orientation=root + 3)
    return place_movers(turning)[anchor].placement


class _Moment(NamedTuple):
    """Poses of the movers and of the body's own frame at a moment."""

    movers: Float[AnyArray, "... D"]
    """Poses of the movers."""
    origin: Float[AnyArray, "... 3"]
    """Position of the frame [m]."""
    orientation: Float[AnyArray, "... 4"] | None
    """Quaternion of the frame; None for a frame that does not turn."""

    def to_own(self, vector: Float[AnyArray, "... 3"]) -> Float[AnyArray, "... 3"]:
        """Return a world vector along the frame's axes."""
        if self.orientation is None:
            return vector
        return rotate_back(self.orientation, vector)


@dataclass(frozen=True, eq=False)
class ShapeContacts:
    """Features of movers, and of possible contacts in a super step, for P nodes and K shapes."""

    turning: tuple[Turns, ...]
    """Whether each mover turns, too: about Z, or freely."""
    anchor: int
    """Number of the mover that holds the body; `FREE` for a body that nothing holds, `HELD` for one held by the world."""
    capsules: tuple[RoundCollider, ...]
    boxes: tuple[BoxCollider, ...]
    ground: float | None
    """Height at which nodes touch the ground [m]; None if there is none."""
    wind: tuple[float, ...]
    """Velocity of the air [m/s]."""
    reach: float
    """Distance from a collider's surface at which its features begin [m]."""
    nodes: tuple[int, ...]
    """Numbers of the sampled nodes."""
    mean: Float[np.ndarray, "P 3"] = field(repr=False)
    """Positions of the nodes in the body's own frame, at zero amplitudes [m]."""
    modes: Float[np.ndarray, "K P 3"] = field(repr=False)
    """Displacement of the nodes by each amplitude."""
    digest: str = field(init=False)
    """Hash of the arrays, so that `repr` identifies compiled code."""

    def __post_init__(self) -> None:
        content = self.mean.astype(np.float32).tobytes() + self.modes.astype(np.float32).tobytes()
        object.__setattr__(self, "digest", hashlib.sha256(content).hexdigest())

    @cached_property
    def movers(self) -> tuple[Mover, ...]:
        """Entries of the movers."""
        return place_movers(self.turning)

    @property
    def mover_size(self) -> int:
        """Number D of entries of all movers' poses."""
        return sum(mover.size for mover in self.movers)

    @property
    def rate_size(self) -> int:
        """Number of entries of all movers' rates, and of their controls."""
        return sum(mover.rate_size for mover in self.movers)

    @property
    def first(self) -> int:
        """State entry of the first amplitude."""
        return first_amplitude(self.turning, self.anchor)

    @property
    def turns(self) -> bool:
        """Whether the body's own frame turns."""
        return self.anchor == FREE or (self.anchor >= 0 and bool(self.turning[self.anchor]))

    def free_axes(self) -> list[tuple[int, ...]]:
        """Return the state entries along each axis along which all may be moved together."""
        if self.anchor == HELD:
            return []
        starts = [mover.entry for mover in self.movers]
        if self.anchor == FREE:
            starts.append(self.first - ROOT)
        count = 3 if self.ground is None else 2
        return [tuple(start + axis for start in starts) for axis in range(count)]

    @cached_property
    def _facing(self) -> tuple[int, ...]:
        """Movers that are shown, whose heading relative to the body changes and matters."""
        uneven = {box.mover for box in self.boxes}
        uneven |= {capsule.mover for capsule in self.capsules if not capsule.is_round}
        facing = []
        for index in sorted((uneven - {self.anchor}) & set(self._shown)):
            if self.turning[index] or self.turns:
                facing.append(index)
        return tuple(facing)

    @cached_property
    def _shown(self) -> tuple[int, ...]:
        """Movers with features of their own: of those that only strike and turn freely, as bones do, nodes show the nearness."""
        return tuple(
            index
            for index, mover in enumerate(self.movers)
            if index == self.anchor or not mover.turns_freely
        )

    @property
    def _shows_up(self) -> bool:
        """Whether the anchor tilts, so that the direction of gravity is a feature; a free root shows its own."""
        return self.anchor >= 0 and self.movers[self.anchor].turns_freely

    @property
    def _shows_wind(self) -> bool:
        return self.turns and any(self.wind)

    @property
    def size(self) -> int:
        """Total length of the result of `shown`."""
        others = len(self._shown) - (self.anchor >= 0)
        vectors = others + len(self._facing) + self._shows_up + self._shows_wind
        rates = sum(self.movers[index].rate_size for index in self._shown)
        return 2 * rates + 3 * vectors + 4 * len(self.nodes) * self._has_colliders

    @property
    def _has_colliders(self) -> bool:
        return (
            bool(self._moving(self.capsules) or self._moving(self.boxes)) or self.ground is not None
        )

    def _moving(self, colliders: tuple[AnyCollider, ...]) -> tuple[AnyCollider, ...]:
        """Return the colliders that move in the body's own frame: the others are fixed in it."""
        return tuple(collider for collider in colliders if collider.mover != self.anchor)

    def common_scale(self, scale: Float[np.ndarray, " V"]) -> Float[np.ndarray, " V"]:
        """Return the scales of the numbers of a change, so that errors in each count as they move the nodes."""
        if self.anchor != FREE:
            return common_scale(scale)
        around = self.mean - self.mean.mean(axis=0)
        return common_scale(scale, np.sqrt((around**2).sum(axis=1).mean()))

    def shown(
        self, state: Float[AnyArray, "... S"], control: Float[AnyArray, "... C"], dt: float
    ) -> list[Float[AnyArray, "... _"]]:
        """Return the features of a state (..., S) and the movers' next rates (..., C) for a network, in pieces.

        All are in the body's own frame: the movers' current and next rates; their positions, and headings unless they are
        round; the vertical, if the anchor tilts; the wind; then, summed over all colliders that move in it, the nearness of
        the nodes (0 beyond `reach`, 1 at the surface, more inside) after `dt` [s], and that times the direction away.
        """
        size = self.mover_size
        now = self._now(state)
        later = self._later(state, control, dt)
        shown = self._rates(now, state[..., size : size + self.rate_size])
        shown += self._rates(now, control)
        for index in self._shown:
            if index != self.anchor:
                position = self.movers[index].placement.origin(now.movers)
                shown.append(now.to_own(position - now.origin))
        for index in self._facing:
            shown.append(self._direction(now, index, (1.0, 0.0, 0.0)))
        if self._shows_up:
            shown.append(now.to_own(_vector((0.0, 0.0, 1.0), now)))
        if self._shows_wind:
            shown.append(now.to_own(_vector(self.wind, now)))
        if self._has_colliders:
            shown += self._nearness(self._nodes_later(state, dt), later)
        return shown

    def _now(self, state: Float[AnyArray, "... S"]) -> _Moment:
        return self._moment(state[..., : self.mover_size], state)

    def _moment(self, movers: Float[AnyArray, "... D"], state: Float[AnyArray, "... S"]) -> _Moment:
        placement = placement_of(self.turning, self.anchor)
        return _Moment(movers, placement.origin(state), placement.quaternions(state))

    def _later(
        self, state: Float[AnyArray, "... S"], control: Float[AnyArray, "... C"], dt: float
    ) -> _Moment:
        """Return the poses after `dt` [s]; a free root coasts."""
        movers = moved(state[..., : self.mover_size], dt * control, quaternion_entries(self.movers))
        if self.anchor != FREE:
            return self._moment(movers, movers)
        root = state[..., self.first - ROOT : self.first]
        origin = root[..., :3] + dt * root[..., 7:10]
        return _Moment(movers, origin, rotated_by(root[..., 3:7], dt * root[..., 10:]))

    def _rates(
        self, now: _Moment, rates: Float[AnyArray, "... D"]
    ) -> list[Float[AnyArray, "... _"]]:
        """Return velocities along the frame's axes [m/s], and turning rates [rad/s] unchanged."""
        shown = []
        for index in self._shown:
            mover = self.movers[index]
            shown.append(now.to_own(rates[..., mover.rate : mover.rate + 3]))
            if mover.turns:
                shown.append(rates[..., mover.rates][..., 3:])
        return shown

    def _direction(self, moment: _Moment, index: int, vector: Point) -> Float[AnyArray, "... 3"]:
        """Return a vector of a mover's frame along the body's axes."""
        return self._directions(moment, [index], [vector])[..., 0, :]

    def _directions(
        self, moment: _Moment, indices: Sequence[int], vectors: Sequence[Point]
    ) -> Float[AnyArray, "... Q 3"]:
        """Return a vector of the frame of each of Q movers along the body's axes.

        All at once: one after another they would make a program that takes minutes to compile for a dozen bones.
        """
        xp = moment.origin.__array_namespace__()
        zeros = xp.zeros_like(moment.origin)
        own = zeros[..., None, :] + xp.asarray(np.array(vectors), dtype=zeros.dtype)
        turned = [self.movers[index].placement.quaternions(moment.movers) for index in indices]
        if any(quaternion is not None for quaternion in turned):
            still = zeros[..., :1] + xp.asarray(NO_ROTATION, dtype=zeros.dtype)
            every = [still if quaternion is None else quaternion for quaternion in turned]
            own = rotate(xp.stack(every, axis=-2), own)
        if moment.orientation is None:
            return own
        return rotate_back(moment.orientation[..., None, :], own)

    def _places(
        self, moment: _Moment, indices: Sequence[int], points: Sequence[Point]
    ) -> Float[AnyArray, "... Q 3"]:
        """Return the position in the body's frame of a point of the frame of each of Q movers."""
        xp = moment.origin.__array_namespace__()
        origins = [self.movers[index].placement.origin(moment.movers) for index in indices]
        away = xp.stack(origins, axis=-2) - moment.origin[..., None, :]
        if moment.orientation is not None:
            away = rotate_back(moment.orientation[..., None, :], away)
        return self._directions(moment, indices, points) + away

    @cached_property
    def _rows(self) -> tuple[Float[np.ndarray, "K X"], Float[np.ndarray, " X"]]:
        """Modes and mean, axis by axis: x of all nodes, y of all, z of all."""
        modes = np.moveaxis(self.modes, 1, 2).reshape(len(self.modes), 3 * len(self.nodes))
        return modes.astype(np.float32), self.mean.T.ravel().astype(np.float32)

    def _nodes_later(self, state: Float[AnyArray, "... S"], dt: float) -> Coordinates:
        """Return x, y and z of the nodes in the body's frame [m] after `dt` [s] at the current rates."""
        xp = state.__array_namespace__()
        count = len(self.modes)
        first = self.first
        amplitudes = state[..., first : first + count]
        rates = state[..., first + count : first + 2 * count]
        modes, mean = self._rows
        placed = (amplitudes + dt * rates) @ xp.asarray(modes, dtype=state.dtype)
        placed = placed + xp.asarray(mean, dtype=state.dtype)
        size = len(self.nodes)
        return [placed[..., axis * size : (axis + 1) * size] for axis in range(3)]

    def _nearness(self, nodes: Coordinates, later: _Moment) -> Coordinates:
        """Return the sum over colliders of the nodes' nearness, and of that times each component of the direction."""
        xp = later.origin.__array_namespace__()
        found = self._surfaces(nodes, later, (), self._moving(self.boxes))
        capsules = self._moving(self.capsules)
        if capsules:
            found.append(self._from_capsules(nodes, later, capsules))
        sums = [xp.zeros_like(nodes[0])] * 4
        for distance, direction in found:
            near = xp.maximum(1 - distance / self.reach, xp.zeros_like(distance))
            parts = [near, *(near * along for along in direction)]
            if distance.ndim > nodes[0].ndim:
                parts = [xp.sum(part, axis=-2) for part in parts]
            sums = [total + part for total, part in zip(sums, parts, strict=True)]
        return sums

    def _surfaces(
        self,
        nodes: Coordinates,
        moment: _Moment,
        capsules: tuple[RoundCollider, ...],
        boxes: tuple[BoxCollider, ...],
    ) -> list[Surface]:
        """Return the distances of nodes from each capsule, each box and the ground [m], and the directions away."""
        found: list[Surface] = []
        if capsules:
            distance, direction = self._from_capsules(nodes, moment, capsules)
            for one in range(len(capsules)):
                found.append((distance[..., one, :], [part[..., one, :] for part in direction]))
        found += [self._from_box(nodes, moment, box) for box in boxes]
        if self.ground is not None:
            found.append(self._from_ground(nodes, moment, self.ground))
        return found

    def distances(self, state: Float[AnyArray, "... S"]) -> Coordinates:
        """Return the distances of the nodes from each capsule, each box and the ground [m]; negative inside."""
        nodes = self._nodes_later(state, 0.0)
        found = self._surfaces(nodes, self._now(state), self.capsules, self.boxes)
        return [distance for distance, _ in found]

    def pushed_out(
        self, points: Float[AnyArray, "... N 3"], states: Float[AnyArray, "... S"]
    ) -> Float[AnyArray, "... N 3"]:
        """Return `points` of the body's own frame [m], with those inside a collider moved to its surface."""
        xp = points.__array_namespace__()
        moment = self._now(states)
        nodes = [points[..., axis] for axis in range(3)]
        for _ in range(ROUNDS):
            depth = xp.zeros_like(nodes[0])
            outward = [xp.zeros_like(nodes[0])] * 3
            for distance, direction in self._surfaces(nodes, moment, self.capsules, self.boxes):
                is_deeper = -distance > depth
                depth = xp.where(is_deeper, -distance, depth)
                outward = [
                    xp.where(is_deeper, new, old)
                    for new, old in zip(direction, outward, strict=True)
                ]
            nodes = [node + depth * along for node, along in zip(nodes, outward, strict=True)]
        return xp.stack(nodes, axis=-1)

    def _from_capsules(
        self, nodes: Coordinates, later: _Moment, capsules: tuple[RoundCollider, ...]
    ) -> tuple[Float[AnyArray, "... Q P"], list[Float[AnyArray, "... Q P"]]]:
        """Return the distances of nodes from the surface of each of Q capsules [m], and the directions away."""
        xp = later.origin.__array_namespace__()
        movers = [one.mover for one in capsules]
        start = self._places(later, movers, [one.start for one in capsules])
        extent = self._directions(later, movers, [one.along for one in capsules])
        squares = [sum(length * length for length in one.along) or 1.0 for one in capsules]
        square, radius = (
            xp.asarray(np.array(values)[:, None], dtype=later.origin.dtype)
            for values in (squares, [one.radius for one in capsules])
        )
        away = [nodes[axis][..., None, :] - start[..., axis : axis + 1] for axis in range(3)]
        along = [extent[..., axis : axis + 1] for axis in range(3)]
        share = xp.clip(_dot(along, away) / square, 0.0, 1.0)
        away = [gap - share * part for part, gap in zip(along, away, strict=True)]
        distance = xp.sqrt(_dot(away, away) + TINY)
        return distance - radius, [gap / distance for gap in away]

    def _from_box(self, nodes: Coordinates, later: _Moment, box: BoxCollider) -> Surface:
        """Return the distances of nodes from the surface [m], negative inside, and the directions away."""
        centre = self._places(later, [box.mover], [box.centre])[..., 0, :]
        away = [nodes[axis] - centre[..., axis : axis + 1] for axis in range(3)]
        units = self._directions(later, [box.mover] * 3, AXES)
        axes = [[units[..., one, axis : axis + 1] for axis in range(3)] for one in range(3)]
        distance, outward = box_surface([_dot(axis, away) for axis in axes], box.half, TINY)
        direction = [_dot([axis[k] for axis in axes], outward) for k in range(3)]
        return distance - box.radius, direction

    def _from_ground(self, nodes: Coordinates, later: _Moment, height: float) -> Surface:
        """Return the heights of nodes over the ground [m], and the directions away."""
        xp = later.origin.__array_namespace__()
        upward = later.to_own(_vector((0.0, 0.0, 1.0), later))
        up = [xp.zeros_like(nodes[0]) + upward[..., axis : axis + 1] for axis in range(3)]
        return _dot(up, nodes) + later.origin[..., 2:3] - height, up

    def to_json(self) -> dict[str, Any]:
        """Return everything but the arrays, which follow from the shapes and the nodes' numbers."""
        return {
            "turning": list(self.turning),
            "anchor": self.anchor,
            "capsules": [[one.mover, *one.start, *one.along, one.radius] for one in self.capsules],
            "boxes": [[one.mover, *one.centre, *one.half, one.radius] for one in self.boxes],
            "ground": self.ground,
            "wind": list(self.wind),
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
        """Return the contacts `to_json` wrote, of a body with this mean and these modes; ValueError names the fault.

        `state_size` is without parameters.
        """
        turning = listed(described["turning"], "shape contacts: turning", _turns)
        if not 1 <= len(turning) <= MAX_MOVERS:
            raise ValueError(f"shape contacts: wanted 1 to {MAX_MOVERS} movers")

        def collider(row: Any, what: str) -> tuple[int, Point, Point, float]:
            mover, *places, radius = numbers(row, what, 8, MAX_DISTANCE)
            if mover not in range(len(turning)):
                raise ValueError(f"{what}: of a mover that does not exist")
            return int(mover), tuple(places[:3]), tuple(places[3:]), radius

        capsules = listed(described["capsules"], "shape contacts: capsules", collider)
        boxes = listed(described["boxes"], "shape contacts: boxes", collider)
        nodes = entries(described["nodes"], "shape contacts: nodes", len(mean))
        if len(capsules) + len(boxes) > MAX_COLLIDERS or not 1 <= len(nodes) <= MAX_NODES:
            raise ValueError("shape contacts: too many colliders or nodes, or no node")
        ground = described["ground"]
        if ground is not None:
            ground = number(ground, "shape contacts: ground", -MAX_DISTANCE, MAX_DISTANCE)
        contacts = cls(
            turning=turning,
            anchor=whole(described["anchor"], "shape contacts: anchor", HELD, len(turning) - 1),
            capsules=tuple(RoundCollider(*one) for one in capsules),
            boxes=tuple(BoxCollider(*one) for one in boxes),
            ground=ground,
            wind=numbers(described["wind"], "shape contacts: wind", 3, MAX_DISTANCE),
            reach=number(described["reach"], "shape contacts: reach", 1e-6, MAX_DISTANCE),
            nodes=nodes,
            mean=mean[list(nodes)],
            modes=modes[:, list(nodes)],
        )
        if controls != contacts.rate_size or state_size != contacts.first + 2 * len(modes):
            raise ValueError("shape contacts: other movers or shapes than the state's")
        return contacts


def _turns(described: Any, what: str) -> Turns:
    """Return how a mover turns in a file."""
    return FREELY if described == FREELY else flag(described, what)


def common_scale(scale: Float[np.ndarray, " V"], gyration: float = 0.0) -> Float[np.ndarray, " V"]:
    """Return the scales of the numbers of a change, so that errors in each count as they move the nodes.

    A change has those of a free root, if there is one, then those of shapes and of their rates. Rotations of the root move
    nodes by the radius of `gyration` [m]; 0 without a root.
    """
    root = 12 if gyration else 0
    levers = np.ones(len(scale))
    if gyration:
        levers[[3, 4, 5, 9, 10, 11]] = gyration
    of_root = np.arange(root).reshape(2, -1)
    of_shapes = np.arange(root, len(scale)).reshape(2, -1)
    common = np.empty(len(scale))
    for row in np.concatenate([of_root, of_shapes], axis=1):
        common[row] = np.sqrt(np.mean((levers * scale)[row] ** 2))
    return common / levers


def box_surface(local: Coordinates, half: Sequence[Any], tiny: float) -> Surface:
    """Return the distances of points from the surface of a box [m], negative inside, and the directions away, along its axes.

    `local` are their coordinates from its centre, `half` is half its size [m]; `tiny` is added under the root [m²].
    """
    xp = local[0].__array_namespace__()
    outside = []
    within = []
    for part, extent in zip(local, half, strict=True):
        outside.append(part - xp.clip(part, -extent, extent))
        within.append(extent - xp.maximum(part, -part))
    nearest = xp.minimum(xp.minimum(within[0], within[1]), within[2])
    is_inside = nearest > 0
    distance = xp.sqrt(_dot(outside, outside) + tiny)
    outward = []
    for part, gap, beyond in zip(local, within, outside, strict=True):
        sign = xp.where(part > 0, xp.ones_like(part), -xp.ones_like(part))
        face = xp.where(gap > nearest, xp.zeros_like(part), sign)
        outward.append(xp.where(is_inside, face, beyond / distance))
    return xp.where(is_inside, -nearest, distance), outward


def _vector(vector: Point, moment: _Moment) -> Float[AnyArray, "... 3"]:
    """Return the same `vector` for each state of a moment."""
    xp = moment.origin.__array_namespace__()
    return xp.zeros_like(moment.origin) + xp.asarray(vector, dtype=moment.origin.dtype)


def _dot(first: list[AnyArray], second: list[AnyArray]) -> AnyArray:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
