"""Cost terms: residuals of a trajectory, in JAX and NumPy alike; `costs` makes them from what users say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.objective import CostTerm, StateTerm
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.arrays import as_parameter
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.links import Link, point_of_chain
from neuroanimator.state.pose import Pose, read_heights, read_pose
from neuroanimator.state.rotation import cross
from neuroanimator.state.structure import Structure

SHORTEST_LEG = 1e-9
"""Share of a path; between points that coincide there is a leg of no length, which nothing can be divided by."""

NEARLY_UPRIGHT = 1e-3
"""[rad] Less counts as this much, so that an upright body has a finite slope."""


@dataclass(frozen=True)
class Moments:
    """Which states of a motion a term looks at: those at some times, the last one if there are none, or all since one."""

    times: tuple[float, ...] = ()
    """[s]"""
    lasts: bool = False
    """Whether all states count from the one time on, so that what is compared is a sum over time."""

    @classmethod
    def of(cls, at: float | tuple[float, ...] | None = None, since: float | None = None) -> Moments:
        """Return the moments `at` a time or several [s], or all `since` one; the end if neither is given.

        Raises ArgumentError for both, and for times that are negative or not finite.
        """
        if at is not None and since is not None:
            raise ArgumentError(f"at and since: wanted one of them, came {at} and {since:g} s.")
        if since is not None:
            return cls((_time("since", since),), lasts=True)
        if at is None:
            return cls()
        times = at if isinstance(at, tuple) else (at,)
        return cls(tuple(_time("at", time) for time in times))

    def rows(self, steps: int, dt: float) -> list[int]:
        """Return which states these are of a motion of so many super steps of `dt` [s]; the start is none of those that last."""
        rows = [round(time / dt) for time in self.times]
        if not self.lasts:
            return rows or [steps]
        first = max(1, min(*rows, steps))
        return list(range(first, steps + 1))

    def share(self, dt: float) -> float:
        """Return what residuals are multiplied by, so that a sum over time does not depend on the super step."""
        return math.sqrt(dt) if self.lasts else 1.0


AT_THE_END = Moments()
"""The last state alone."""

ALL_ALONG = Moments((0.0,), lasts=True)
"""Every state but the start."""


def _time(label: str, seconds: float) -> float:
    if not 0 <= seconds < math.inf:
        raise ArgumentError(f"{label}: wanted a time of at least 0 s, came {seconds:g}.")
    return float(seconds)


class TimedTerm(StateTerm):
    """A term that looks at the states at some moments."""

    when: Moments = eqx.field(static=True)

    def rows(self, steps: int, dt: float) -> list[int]:
        return self.when.rows(steps, dt)


class Effort(CostTerm):
    """μ_u: ∫ |u / scale|² dt, so that J does not depend on the super step (eq. 11)."""

    weight: Float[AnyArray, ""]
    of_controls: ClassVar[bool] = True

    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        efforts = trajectory.controls / trajectory.control_scale
        return math.sqrt(trajectory.dt) * efforts.ravel()


class Smoothness(CostTerm):
    """∫ |du/dt / scale|² dt in [s²]: controls that do not jump."""

    weight: Float[AnyArray, ""]
    of_controls: ClassVar[bool] = True

    def residuals(self, trajectory: Trajectory) -> Float[AnyArray, " R"]:
        controls = trajectory.controls
        jumps = controls.__array_namespace__().diff(controls, axis=0) / trajectory.control_scale
        return jumps.ravel() / math.sqrt(trajectory.dt)


class ReachState(TimedTerm):
    """Be in a state, or in part of one, seen from the goal: in a parking bay, lengthwise and sideways."""

    weight: Float[AnyArray, ""]
    frame: Frame
    goal: Float[AnyArray, " S"]
    judged: Float[AnyArray, "R V"]
    """Turns the difference from the goal into numbers of which one is a sizeable error."""

    @classmethod
    def of(
        cls,
        frame: Frame,
        goal: ArrayLike,
        judged: ArrayLike,
        weight: float,
        when: Moments = AT_THE_END,
    ) -> ReachState:
        """Return the cost of not being at `goal` (S,); `judged` (R, V) makes residuals of the difference."""
        return cls(
            weight=as_weight(weight),
            frame=frame,
            goal=as_parameter(goal),
            judged=as_parameter(judged),
            when=when,
        )

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B R"]:
        xp = state.__array_namespace__()
        goal = xp.broadcast_to(xp.asarray(self.goal), state.shape)
        return self.frame.difference(goal, state) @ self.judged.T

    def compare(self, observed: Float[AnyArray, "K O"], dt: float) -> Float[AnyArray, " R"]:
        return self.when.share(dt) * observed.ravel()


class ReachPositions(TimedTerm):
    """Be at positions at given times: keyframes, or one position at the end."""

    weight: Float[AnyArray, ""]
    structure: Structure = eqx.field(static=True)
    positions: Float[AnyArray, "K A"]
    """[m] Along the axes that matter."""
    within: Float[AnyArray, ""]
    axes: tuple[int, ...] = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B A"]:
        return _along(self.axes, read_pose(self.structure, state).position)

    def compare(self, observed: Float[AnyArray, "K A"], dt: float) -> Float[AnyArray, " R"]:
        return self.when.share(dt) * ((observed - self.positions) / self.within).ravel()


class ReachPoint(TimedTerm):
    """Be somewhere with a point of the body, such as a hand: at given times, or from one on."""

    weight: Float[AnyArray, ""]
    chain: tuple[Link, ...] = eqx.field(static=True)
    """From the world to the body the point lies on."""
    offset: tuple[float, ...] = eqx.field(static=True)
    """[m] In that body's frame."""
    position: Float[AnyArray, " A"]
    """[m] Along the axes that matter."""
    within: Float[AnyArray, ""]
    axes: tuple[int, ...] = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B A"]:
        return _along(self.axes, point_of_chain(self.chain, self.offset, state))

    def compare(self, observed: Float[AnyArray, "K A"], dt: float) -> Float[AnyArray, " R"]:
        return self.when.share(dt) * ((observed - self.position) / self.within).ravel()


class ReachHeight(TimedTerm):
    """Be up with all of the body at given times: the rms of how far mass points are below a height."""

    weight: Float[AnyArray, ""]
    structure: Structure = eqx.field(static=True)
    height: Float[AnyArray, ""]
    """[m]"""
    within: Float[AnyArray, ""]

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B N"]:
        return read_heights(self.structure, state)

    def compare(self, observed: Float[AnyArray, "K N"], dt: float) -> Float[AnyArray, " R"]:
        xp = observed.__array_namespace__()
        below = xp.maximum(self.height - observed, 0) / self.within
        return (below / math.sqrt(observed.shape[-1])).ravel()


class FollowPath(StateTerm):
    """Be where a path says all along, passed at a steady pace."""

    weight: Float[AnyArray, ""]
    structure: Structure = eqx.field(static=True)
    points: Float[AnyArray, "K A"]
    shares: Float[AnyArray, " K"]
    """Length of the path up to each point, as a share of the whole."""
    within: Float[AnyArray, ""]
    axes: tuple[int, ...] = eqx.field(static=True)

    def rows(self, steps: int, dt: float) -> list[int]:
        return ALL_ALONG.rows(steps, dt)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B A"]:
        return _along(self.axes, read_pose(self.structure, state).position)

    def compare(self, observed: Float[AnyArray, "T A"], dt: float) -> Float[AnyArray, " R"]:
        xp = observed.__array_namespace__()
        share = xp.arange(1, len(observed) + 1) / len(observed)
        # Leg by leg, not by interpolation, which looks up where it is: for that there is no C.
        lengths = xp.maximum(xp.diff(self.shares), SHORTEST_LEG)
        passed = xp.clip((share[:, None] - self.shares[:-1]) / lengths, 0, 1)
        wanted = self.points[0] + passed @ xp.diff(self.points, axis=0)
        return ALL_ALONG.share(dt) * ((observed - wanted) / self.within).ravel()


class TravelTerm(TimedTerm):
    """Come `distance` [m] forward along `direction`; further than possible means as far as possible."""

    weight: Float[AnyArray, ""]
    when: Moments = eqx.field(static=True)
    direction: Float[AnyArray, " 3"]
    distance: Float[AnyArray, ""]
    within: Float[AnyArray, ""]

    def rows(self, steps: int, dt: float) -> list[int]:
        return [0, *super().rows(steps, dt)]

    def compare(self, observed: Float[AnyArray, "K 3"], dt: float) -> Float[AnyArray, " R"]:
        travelled = (observed[1:] - observed[0]) @ self.direction
        return self.when.share(dt) * (self.distance - travelled) / self.within


class Travel(TravelTerm):
    """Come forward with the root, or with a deformable body's centroid."""

    structure: Structure = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 3"]:
        return read_pose(self.structure, state).position


class TravelPoint(TravelTerm):
    """Come forward with one body of many."""

    chain: tuple[Link, ...] = eqx.field(static=True)
    """From the world to that body."""

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 3"]:
        return point_of_chain(self.chain, (0.0, 0.0, 0.0), state)


class KeepVelocity(TimedTerm):
    """Move with a velocity, from a given time on."""

    weight: Float[AnyArray, ""]
    structure: Structure = eqx.field(static=True)
    velocity: Float[AnyArray, " A"]
    within: Float[AnyArray, ""]
    axes: tuple[int, ...] = eqx.field(static=True)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B A"]:
        return _along(self.axes, read_pose(self.structure, state).velocity)

    def compare(self, observed: Float[AnyArray, "K A"], dt: float) -> Float[AnyArray, " R"]:
        off = (observed - self.velocity) / self.within
        return self.when.share(dt) * off.ravel()


class KeepSpeed(TimedTerm):
    """Move forward, where the body points, at a speed, from a given time on."""

    weight: Float[AnyArray, ""]
    structure: Structure = eqx.field(static=True)
    speed: Float[AnyArray, ""]
    within: Float[AnyArray, ""]

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 1"]:
        pose = read_pose(self.structure, state)
        xp = state.__array_namespace__()
        return xp.sum(pose.velocity * pose.forward, axis=-1, keepdims=True)

    def compare(self, observed: Float[AnyArray, "K 1"], dt: float) -> Float[AnyArray, " K"]:
        return self.when.share(dt) * (observed[:, 0] - self.speed) / self.within


class Point(TimedTerm):
    """Point forward, or stand upright, along `direction`: at given times, or from one on."""

    weight: Float[AnyArray, ""]
    structure: Structure = eqx.field(static=True)
    direction: Float[AnyArray, " 3"]
    within: Float[AnyArray, ""]
    """[rad]"""
    axis: str = eqx.field(static=True)
    """`forward` or `upward`."""

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 3"]:
        return getattr(read_pose(self.structure, state), self.axis)

    def compare(self, observed: Float[AnyArray, "K 3"], dt: float) -> Float[AnyArray, " R"]:
        off = (observed - self.direction) / self.within
        return self.when.share(dt) * off.ravel()


class StayUpright(TimedTerm):
    """Keep the body's up near the world's, from a given time on: ∫ of the angle beyond a tolerance."""

    weight: Float[AnyArray, ""]
    structure: Structure = eqx.field(static=True)
    tolerance: Float[AnyArray, ""]
    """[rad] Leaning that costs nothing."""
    within: Float[AnyArray, ""]
    """[rad]"""
    may_pitch: bool = eqx.field(static=True)
    """Whether only rolling counts, so that the body may dive and leap."""

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B 1"]:
        return lean(read_pose(self.structure, state), may_pitch=self.may_pitch)[..., None]

    def compare(self, observed: Float[AnyArray, "K 1"], dt: float) -> Float[AnyArray, " K"]:
        xp = observed.__array_namespace__()
        beyond = xp.maximum(observed[:, 0] - self.tolerance, 0)
        return self.when.share(dt) * beyond / self.within


def lean(pose: Pose, *, may_pitch: bool) -> Float[AnyArray, "*B"]:
    """Return by how much [rad] bodies lean: 0 upright, π upside down; by rolling alone if they `may_pitch`."""
    xp = pose.upward.__array_namespace__()
    if may_pitch:
        aside = cross(pose.upward, pose.forward)[..., 2] ** 2
        along = xp.sum(pose.upward * pose.forward, axis=-1)
        above = pose.upward[..., 2] - pose.forward[..., 2] * along
    else:
        aside = xp.sum(pose.upward[..., :2] ** 2, axis=-1)
        above = pose.upward[..., 2]
    return xp.atan2(xp.sqrt(aside + NEARLY_UPRIGHT**2), above)


class StayWithin(StateTerm):
    """Keep state entries between bounds, such as joints: ∫ of what is beyond."""

    weight: Float[AnyArray, ""]
    low: Float[AnyArray, " E"]
    high: Float[AnyArray, " E"]
    within: Float[AnyArray, ""]
    entries: tuple[int, ...] = eqx.field(static=True)

    def rows(self, steps: int, dt: float) -> list[int]:
        return ALL_ALONG.rows(steps, dt)

    def observe(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B E"]:
        return state[..., np.array(self.entries)]

    def compare(self, observed: Float[AnyArray, "T E"], dt: float) -> Float[AnyArray, " R"]:
        xp = observed.__array_namespace__()
        above = xp.maximum(observed - self.high, 0)
        below = xp.maximum(self.low - observed, 0)
        beyond = (above + below) / self.within
        return ALL_ALONG.share(dt) * beyond.ravel()


def as_weight(weight: float) -> Float[AnyArray, ""]:
    """Return an array: another weight needs no other program."""
    return as_parameter(weight)


def _along(axes: tuple[int, ...], vector: Float[AnyArray, "*B 3"]) -> Float[AnyArray, "*B A"]:
    return vector[..., np.array(axes)]
