"""Cost terms: for each a class with its residuals, in JAX and NumPy alike, then the functions that make it.

A function's name is a name of `neuroanimator` and a kind of cost in objective files, both through `__all__`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.objective import (
    ALL_ALONG,
    AT_THE_END,
    CostTerm,
    Moments,
    TimedTerm,
    Trajectory,
)
from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import as_numbers
from neuroanimator.state.links import Link, point_of_chain
from neuroanimator.state.placement import Placement
from neuroanimator.state.pose import Pose, has_pose, read_heights, read_pose
from neuroanimator.state.rotation import cross
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import System

__all__ = [
    "effort",
    "follow_path",
    "keep_heading",
    "keep_speed",
    "keep_velocity",
    "reach_heading",
    "reach_height",
    "reach_node",
    "reach_point",
    "reach_position",
    "reach_positions",
    "smoothness",
    "stand_up",
    "stay_upright",
    "stay_within",
    "travel",
]

SHORTEST_LEG = 1e-9
"""Minimum length of a leg, as a share of the path: coinciding points would lead to division by zero."""

NEARLY_UPRIGHT = 1e-3
"""Minimum angle of leaning [rad]: smaller ones count as this, so that an upright body has a finite gradient."""

FAR = 1e9
"""Bound that no state reaches, on the side on which a term has none; programs in C know no infinity."""

PATH_SHARE = 0.1
"""Default distance from a path that is an error of one, as a share of its length."""


class Effort(CostTerm):
    """μ_u: ∫ |u / scale|² dt, so that J does not depend on the super step (eq. 11)."""

    of_controls: ClassVar[bool] = True

    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        efforts = trajectory.controls / trajectory.control_scale
        return math.sqrt(trajectory.dt) * efforts.ravel()


def effort(weight: float = 1.0) -> Effort:
    """Return the cost of effort: large controls."""
    return Effort(as_parameter(weight))


class Smoothness(CostTerm):
    """∫ |du/dt / scale|² dt in [s²]: penalises jumps of the controls."""

    of_controls: ClassVar[bool] = True

    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        controls = trajectory.controls
        jumps = controls.__array_namespace__().diff(controls, axis=0) / trajectory.control_scale
        return jumps.ravel() / math.sqrt(trajectory.dt)


def smoothness(weight: float = 0.01) -> Smoothness:
    """Return the cost of controls that jump."""
    return Smoothness(as_parameter(weight))


class NearTerm(TimedTerm):
    """A term that wants its observations near given numbers: a deviation of `within` is an error of one."""

    wanted: Float[AnyArray, "*K A"]
    """Wanted numbers: one row for all moments, or one for each."""
    within: Float[AnyArray, ""]

    def compare(self, observed: Float[AnyArray, "K A"], dt: float) -> Float[AnyArray, " R"]:
        return self.when.share(dt) * ((observed - self.wanted) / self.within).ravel()


class NearPose(NearTerm):
    """Term for a position, a velocity or a direction of the root, or of a deformable body as a whole."""

    structure: Structure = eqx.field(static=True)
    quantity: str = eqx.field(static=True)
    """Name of the quantity in `Pose`: `position`, `velocity`, `forward` or `upward`."""
    axes: tuple[int, ...] = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B A"]:
        vector = getattr(read_pose(self.structure, state), self.quantity)
        return vector[..., np.array(self.axes)]


def reach_position(
    system: System,
    position: ArrayLike,
    *,
    within: float,
    at: float | None = None,
    since: float | None = None,
    axes: str = "xyz",
    weight: float = 1.0,
) -> NearPose:
    """Return the cost of not being at `position` [m] at the end, at `at` [s], or from `since` [s] on.

    `axes` lists which of x, y, z it gives.
    """
    positions = as_numbers(position, "position")[None]
    term = reach_positions(system, positions, None, within=within, axes=axes, weight=weight)
    return replace(term, when=Moments.of(at, since))


def reach_positions(
    system: System,
    positions: ArrayLike,
    times: Sequence[float] | None,
    *,
    within: float,
    axes: str = "xyz",
    weight: float = 1.0,
) -> NearPose:
    """Return the cost of not being at `positions` (K, A) [m] at `times` (K,) [s]."""
    which = _axes(axes)
    wanted = _numbers("places", positions, len(which), rows=True)
    when = AT_THE_END
    if times is not None:
        if len(times) != len(wanted) or not min(times) >= 0:
            raise ArgumentError(
                f"keyframes: wanted {len(wanted)} times of at least 0 s, got {list(times)}."
            )
        when = Moments.of(tuple(times))
    return _near_pose(system, "position", wanted, within, weight, when, which)


def keep_velocity(
    system: System,
    velocity: ArrayLike,
    *,
    within: float,
    since: float = 0.0,
    axes: str = "xyz",
    weight: float = 1.0,
) -> NearPose:
    """Return the cost of not moving with `velocity` (A,) [m/s] in the world from `since` [s] on."""
    which = _axes(axes)
    wanted = _numbers("velocity", velocity, len(which))
    when = Moments.of(None, since)
    return _near_pose(system, "velocity", wanted, within, weight, when, which)


def keep_heading(
    system: System, direction: ArrayLike, *, within: float, since: float = 0.0, weight: float = 1.0
) -> NearPose:
    """Return the cost of not pointing along `direction` (3,) in the world, within `within` [rad], from `since` [s] on."""
    wanted = _unit_vector("direction", direction)
    return _near_pose(system, "forward", wanted, within, weight, Moments.of(None, since))


def reach_heading(
    system: System,
    direction: ArrayLike,
    *,
    within: float,
    at: float | None = None,
    weight: float = 1.0,
) -> NearPose:
    """Return the cost of not pointing along `direction` (3,), within `within` [rad], at the end or at `at` [s]."""
    wanted = _unit_vector("direction", direction)
    return _near_pose(system, "forward", wanted, within, weight, Moments.of(at))


def stand_up(
    system: System, *, within: float, at: float | None = None, weight: float = 1.0
) -> NearPose:
    """Return the cost of the body's Z not pointing up, within `within` [rad], at the end or at `at` [s]."""
    up = as_parameter([0.0, 0.0, 1.0])
    return _near_pose(system, "upward", up, within, weight, Moments.of(at))


def _near_pose(
    system: System,
    quantity: str,
    wanted: Float[np.ndarray, "*K A"],
    within: float,
    weight: float,
    when: Moments,
    axes: tuple[int, ...] = (0, 1, 2),
) -> NearPose:
    return NearPose(
        weight=as_parameter(weight),
        when=when,
        wanted=wanted,
        within=_positive("within", within),
        structure=_structure(system),
        quantity=quantity,
        axes=axes,
    )


class NearSpeed(NearTerm):
    """Term for moving at a speed in the direction the body points."""

    structure: Structure = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 1"]:
        pose = read_pose(self.structure, state)
        xp = state.__array_namespace__()
        return xp.sum(pose.velocity * pose.forward, axis=-1, keepdims=True)


def keep_speed(
    system: System, speed: float, *, within: float, since: float = 0.0, weight: float = 1.0
) -> NearSpeed:
    """Return the cost of not moving forward at `speed` [m/s] from `since` [s] on."""
    return NearSpeed(
        weight=as_parameter(weight),
        when=Moments.of(None, since),
        wanted=_numbers("speed", [speed], 1),
        within=_positive("within", within),
        structure=_structure(system),
    )


class NearPoint(NearTerm):
    """Term for the position of a point of the body, such as a hand."""

    chain: tuple[Link, ...] = eqx.field(static=True)
    """Links from the world to the point's body."""
    offset: tuple[float, ...] = eqx.field(static=True)
    """Position of the point in that body's frame [m]."""
    axes: tuple[int, ...] = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B A"]:
        return point_of_chain(self.chain, self.offset, state)[..., np.array(self.axes)]


def reach_point(
    system: System,
    body: str,
    position: ArrayLike,
    *,
    within: float,
    offset: ArrayLike = (0.0, 0.0, 0.0),
    at: float | None = None,
    since: float | None = None,
    axes: str = "xyz",
    weight: float = 1.0,
) -> NearPoint:
    """Return the cost of a point of `body` not being at `position` [m] at the end, at `at` [s], or from `since` [s] on.

    The point is at `offset` (3,) [m] in MuJoCo's frame of the body: a hand, a mouth, the tip of a tool.
    """
    which = _axes(axes)
    place = _numbers("offset", offset, 3)
    return NearPoint(
        weight=as_parameter(weight),
        when=Moments.of(at, since),
        wanted=_numbers("position", position, len(which)),
        within=_positive("within", within),
        chain=system.skeleton.chain_to(body),
        offset=tuple(map(float, place)),
        axes=which,
    )


class NearNode(NearTerm):
    """Term for the position of a node of a soft body, such as a flag's corner."""

    place: Float[AnyArray, " 3"]
    """Position in the anchor's frame if all amplitudes are zero [m]."""
    modes: Float[AnyArray, "R 3"]
    """Displacement of the node per amplitude: no other node need be computed."""
    first: int = eqx.field(static=True)
    """State entry of the first amplitude."""
    placement: Placement = eqx.field(static=True)
    """State entries of the frame that all nodes move with."""
    axes: tuple[int, ...] = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B A"]:
        amplitudes = state[..., self.first : self.first + self.modes.shape[0]]
        node = self.place + amplitudes @ self.modes
        placed = self.placement.to_world(state, node[..., None, :])[..., 0, :]
        return placed[..., np.array(self.axes)]


def reach_node(
    system: System,
    node: int,
    position: ArrayLike,
    *,
    within: float,
    at: float | None = None,
    since: float | None = None,
    axes: str = "xyz",
    weight: float = 1.0,
) -> NearNode:
    """Return the cost of a soft body's node not being at `position` [m] at the end, at `at` [s], or from `since` [s] on.

    Nodes are numbered from 0 in the order of the mesh. Raises ArgumentError if the body is not soft, or has no such node.
    """
    which = _axes(axes)
    shapes = system.skeleton.shapes
    if shapes is None:
        raise ArgumentError(
            f"node: {system.name} is no soft body, so it has no nodes. Use reach_point for a point of a body."
        )
    if not 0 <= node < len(shapes.mean):
        raise ArgumentError(f"node: wanted 0 to {len(shapes.mean) - 1}, got {node}.")
    return NearNode(
        weight=as_parameter(weight),
        when=Moments.of(at, since),
        wanted=_numbers("position", position, len(which)),
        within=_positive("within", within),
        place=as_parameter(shapes.mean[node]),
        modes=as_parameter(shapes.modes[:, node]),
        first=shapes.first,
        placement=shapes.placement,
        axes=which,
    )


class BoundedTerm(TimedTerm):
    """A term that wants its observations between bounds: an excess of `within` is an error of one."""

    low: Float[AnyArray, "*A"]
    high: Float[AnyArray, "*A"]
    within: Float[AnyArray, ""]

    def compare(self, observed: Float[AnyArray, "K A"], dt: float) -> Float[AnyArray, " R"]:
        xp = observed.__array_namespace__()
        above = xp.maximum(observed - self.high, 0)
        below = xp.maximum(self.low - observed, 0)
        return self.when.share(dt) * ((above + below) / self.within).ravel()


class ReachHeight(BoundedTerm):
    """Term for the whole body being above a height at given times: distances of its mass points below it."""

    structure: Structure = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B N"]:
        return read_heights(self.structure, state)


def reach_height(
    system: System, height: float, *, within: float, at: float | None = None, weight: float = 1.0
) -> ReachHeight:
    """Return the cost of any part of the body being below `height` [m] at the end, or at `at` [s].

    For a deformable body the parts are its mass points, so that a leap lifts its tail out of the water, too; for a rigid
    body it is the root's position.
    """
    points = read_heights(_structure(system), system.rest).shape[-1]
    return ReachHeight(
        weight=as_parameter(weight),
        structure=system.structure,
        low=_numbers("height", [height], 1).reshape(()),
        high=as_parameter(FAR),
        # So that the residuals' squares add up to the mean square of the points' distances.
        within=as_parameter(_positive("within", within) * math.sqrt(points)),
        when=Moments.of(at),
    )


class FollowPath(TimedTerm):
    """Term for following a path at a steady pace."""

    structure: Structure = eqx.field(static=True)
    points: Float[AnyArray, "K A"]
    shares: Float[AnyArray, " K"]
    """Length of the path up to each point, as a share of the whole."""
    within: Float[AnyArray, ""]
    axes: tuple[int, ...] = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B A"]:
        return read_pose(self.structure, state).position[..., np.array(self.axes)]

    def compare(self, observed: Float[AnyArray, "T A"], dt: float) -> Float[AnyArray, " R"]:
        xp = observed.__array_namespace__()
        share = xp.arange(1, len(observed) + 1) / len(observed)
        # Leg by leg instead of by interpolation, whose lookup has no C.
        lengths = xp.maximum(xp.diff(self.shares), SHORTEST_LEG)
        passed = xp.clip((share[:, None] - self.shares[:-1]) / lengths, 0, 1)
        wanted = self.points[0] + passed @ xp.diff(self.points, axis=0)
        return self.when.share(dt) * ((observed - wanted) / self.within).ravel()


def follow_path(
    system: System,
    points: ArrayLike,
    *,
    within: float | None = None,
    axes: str = "xyz",
    weight: float = 1.0,
) -> FollowPath:
    """Return the cost of straying from a path through `points` (K, A) [m], followed at a steady pace to its last point.

    A distance of `within` [m] is an error of one; by default a tenth of the path's length.
    """
    which = _axes(axes)
    points = _numbers("points", points, len(which), rows=True)
    legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    lengths = np.concatenate([[0.0], np.cumsum(legs)])
    if len(points) < 2 or not lengths[-1] > 0:
        raise ArgumentError(
            f"follow_path: wanted at least two different points, got {len(points)}."
        )
    if within is None:
        within = PATH_SHARE * float(lengths[-1])
    return FollowPath(
        weight=as_parameter(weight),
        structure=_structure(system),
        points=points,
        shares=as_parameter(lengths / lengths[-1]),
        within=_positive("within", within),
        axes=which,
        when=ALL_ALONG,
    )


class Travel(TimedTerm):
    """Term for travelling `distance` [m] along `direction`; an impossible distance means as far as possible."""

    direction: Float[AnyArray, " 3"]
    distance: Float[AnyArray, ""]
    within: Float[AnyArray, ""]
    structure: Structure = eqx.field(static=True)
    chain: tuple[Link, ...] = eqx.field(static=True)
    """Links from the world to one of several bodies; none for the root, or a deformable body's centroid."""

    def rows(self, steps: int, dt: float) -> list[int]:
        return [0, *super().rows(steps, dt)]

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 3"]:
        if self.chain:
            return point_of_chain(self.chain, (0.0, 0.0, 0.0), state)
        return read_pose(self.structure, state).position

    def compare(self, observed: Float[AnyArray, "K 3"], dt: float) -> Float[AnyArray, " R"]:
        travelled = (observed[1:] - observed[0]) @ self.direction
        return self.when.share(dt) * (self.distance - travelled) / self.within


def travel(
    system: System,
    direction: ArrayLike,
    distance: float,
    *,
    within: float,
    body: str | None = None,
    since: float | None = None,
    weight: float = 1.0,
) -> Travel:
    """Return the cost of not travelling `distance` [m] along `direction` (3,) by the end, or from `since` [s] on.

    A distance slightly beyond what is possible means as far as possible by the end. In closed loop use `since` 0 s, for as
    soon as possible: what is wanted by the end of every plan may be postponed at every plan.
    The travelling point is MuJoCo's origin of `body`; by default the root, which must be free, or a
    deformable body's centroid.
    """
    names = [bone.name for bone in system.skeleton.bones if bone.joints]
    if body is None and names and not has_pose(system.structure):
        raise ArgumentError(
            f'travel: {system.name} has no free root. Name the body to move forward: body = "{names[0]}", '
            f"or another of {', '.join(names)}."
        )
    structure = _structure(system) if body is None else system.structure
    return Travel(
        weight=as_parameter(weight),
        when=Moments.of(None, since),
        direction=_unit_vector("direction", direction),
        distance=_positive("distance", distance),
        within=_positive("within", within),
        structure=structure,
        chain=() if body is None else system.skeleton.chain_to(body),
    )


class StayUpright(BoundedTerm):
    """Term for staying upright from a given time on: ∫ of the angle of leaning [rad] beyond a tolerance."""

    structure: Structure = eqx.field(static=True)
    may_pitch: bool = eqx.field(static=True)
    """Whether only rolling counts, so that the body may dive and leap."""

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 1"]:
        return _lean(read_pose(self.structure, state), may_pitch=self.may_pitch)[..., None]


def stay_upright(
    system: System,
    *,
    tolerance: float = 0.2,
    within: float = 0.15,
    may_pitch: bool = False,
    since: float = 0.0,
    weight: float = 1.0,
) -> StayUpright:
    """Return the cost of the body's Z leaning more than `tolerance` [rad] from the vertical, from `since` [s] on.

    An excess of `within` [rad] for a second is an error of one. A body that `may_pitch`, to dive or to
    leap, is only kept from rolling over.
    """
    return StayUpright(
        weight=as_parameter(weight),
        structure=_structure(system),
        low=as_parameter(-FAR),
        high=_positive("tolerance", tolerance),
        within=_positive("within", within),
        may_pitch=may_pitch,
        when=Moments.of(None, since),
    )


def _lean(pose: Pose, *, may_pitch: bool) -> Float[AnyArray, "*B"]:
    """Return the angle by which bodies lean [rad]: 0 upright, π upside down; the roll alone if they `may_pitch`."""
    xp = pose.upward.__array_namespace__()
    if may_pitch:
        aside = cross(pose.upward, pose.forward)[..., 2] ** 2
        along = xp.sum(pose.upward * pose.forward, axis=-1)
        above = pose.upward[..., 2] - pose.forward[..., 2] * along
    else:
        aside = xp.sum(pose.upward[..., :2] ** 2, axis=-1)
        above = pose.upward[..., 2]
    return xp.atan2(xp.sqrt(aside + NEARLY_UPRIGHT**2), above)


class StayWithin(BoundedTerm):
    """Term for keeping state entries, such as joints, between bounds: ∫ of the excess."""

    entries: tuple[int, ...] = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B E"]:
        return state[..., np.array(self.entries)]


def stay_within(
    system: System,
    part: str,
    low: ArrayLike,
    high: ArrayLike,
    *,
    within: float,
    weight: float = 1.0,
) -> StayWithin:
    """Return the cost of the state's `part`, such as a joint, leaving the range from `low` to `high`, in its unit."""
    where = system.state.index(part)
    entries = tuple(range(where.start, where.stop))
    lows = _numbers("low", np.atleast_1d(low), None)
    highs = _numbers("high", np.atleast_1d(high), None)
    sizes = (1, len(entries))
    if len(lows) not in sizes or len(highs) not in sizes:
        raise ArgumentError(
            f"stay_within: wanted one bound or {len(entries)} for '{part}', got {low} and {high}."
        )
    lows = np.broadcast_to(lows, len(entries))
    highs = np.broadcast_to(highs, len(entries))
    if not (lows < highs).all():
        raise ArgumentError(
            f"stay_within: wanted low below high for '{part}', got {low} and {high}."
        )
    return StayWithin(
        weight=as_parameter(weight),
        low=lows,
        high=highs,
        within=_positive("within", within),
        entries=entries,
        when=ALL_ALONG,
    )


def _structure(system: System) -> Structure:
    """Return the structure of `system`; ArgumentError if states do not contain a position."""
    read_pose(system.structure, system.rest)
    return system.structure


def _axes(names: str) -> tuple[int, ...]:
    if not names or any(name not in "xyz" for name in names) or len(set(names)) != len(names):
        raise ArgumentError(f"axes: wanted some of x, y, z, such as 'xy', got '{names}'.")
    return tuple("xyz".index(name) for name in names)


def _numbers(
    label: str, values: ArrayLike, size: int | None, *, rows: bool = False
) -> Float[np.ndarray, " ..."]:
    """Return `values` (`size`,), or rows of them; ArgumentError unless all are finite and there is at least one."""
    array = as_numbers(values, label)
    axes = 2 if rows else 1
    has_size = size is None or array.shape[-1:] == (size,)
    if array.ndim != axes or not array.size or not has_size or not np.isfinite(array).all():
        numbers = "number" if size == 1 else "numbers"
        wanted = f"{size or 'some'} finite {numbers}"
        if rows:
            wanted = f"rows of {wanted}"
        raise ArgumentError(f"{label}: wanted {wanted}, got {array.tolist()}.")
    return as_parameter(array)


def _positive(label: str, value: float) -> Float[np.ndarray, " ..."]:
    if not 0 < value < math.inf:
        raise ArgumentError(f"{label}: wanted a finite number above 0, got {value:g}.")
    return as_parameter(value)


def _unit_vector(label: str, direction: ArrayLike) -> Float[np.ndarray, " ..."]:
    vector = _numbers(label, direction, 3)
    length = float(np.linalg.norm(vector))
    if length == 0:
        raise ArgumentError(f"{label}: wanted a direction, got zeros.")
    return vector / length
