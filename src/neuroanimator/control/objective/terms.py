"""Cost terms as JAX sees them: residuals of a trajectory; `costs` makes them from what users say."""

from __future__ import annotations

import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.objective import CostTerm
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.pose import Pose, read_heights, read_pose
from neuroanimator.state.structure import Structure

END: tuple[float, ...] = ()
"""Times that stand for the end of the motion."""

NEARLY_UPRIGHT = 1e-3
"""[rad] Less counts as this much, so that an upright body has a finite slope."""


def rows_at(times: tuple[float, ...], trajectory: Trajectory) -> list[int]:
    """Return which states are those at `times` [s]; the last one for `END`."""
    if times == END:
        return [len(trajectory.states) - 1]
    return [round(time / trajectory.dt) for time in times]


class Effort(CostTerm):
    """μ_u: ∫ |u / scale|² dt, so that J does not depend on the super step (eq. 11)."""

    weight: Float[Array, ""]
    of_controls: ClassVar[bool] = True

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        efforts = trajectory.controls / trajectory.control_scale
        return math.sqrt(trajectory.dt) * efforts.ravel()


class Smoothness(CostTerm):
    """∫ |du/dt / scale|² dt in [s²]: controls that do not jump."""

    weight: Float[Array, ""]
    of_controls: ClassVar[bool] = True

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        jumps = jnp.diff(trajectory.controls, axis=0) / trajectory.control_scale
        return jumps.ravel() / math.sqrt(trajectory.dt)


class ReachState(CostTerm):
    """Be in a state, or in part of one, seen from the goal: in a parking bay, lengthwise and sideways."""

    weight: Float[Array, ""]
    frame: Frame
    goal: Float[Array, " S"]
    compare: Float[Array, "R V"]
    """Turns the difference from the goal into numbers of which one is a sizeable error."""
    times: tuple[float, ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        frame: Frame,
        goal: ArrayLike,
        compare: ArrayLike,
        weight: float,
        times: tuple[float, ...],
    ) -> ReachState:
        """Return the cost of not being at `goal` (S,); `compare` (R, V) makes residuals of the difference."""
        return cls(as_weight(weight), frame, as_jax(goal), as_jax(compare), times)

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        states = trajectory.states[jnp.array(rows_at(self.times, trajectory))]

        def residuals_of(state: Array) -> Array:
            return self.compare @ self.frame.difference(self.goal, state)

        return jax.vmap(residuals_of)(states).ravel()


class ReachPositions(CostTerm):
    """Be at positions at given times: keyframes, or one position at the end."""

    weight: Float[Array, ""]
    structure: Structure = eqx.field(static=True)
    positions: Float[Array, "K A"]
    """[m] Along the axes that matter."""
    within: Float[Array, ""]
    axes: tuple[int, ...] = eqx.field(static=True)
    times: tuple[float, ...] = eqx.field(static=True)

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        states = trajectory.states[jnp.array(rows_at(self.times, trajectory))]
        position = read_pose(self.structure, states).position[:, self.axes]
        return ((position - self.positions) / self.within).ravel()


class ReachHeight(CostTerm):
    """Be up with all of the body at given times: the rms of how far mass points are below a height."""

    weight: Float[Array, ""]
    structure: Structure = eqx.field(static=True)
    height: Float[Array, ""]
    """[m]"""
    within: Float[Array, ""]
    times: tuple[float, ...] = eqx.field(static=True)

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        states = trajectory.states[jnp.array(rows_at(self.times, trajectory))]
        heights = read_heights(self.structure, states)
        below = jnp.maximum(self.height - heights, 0) / self.within
        return (below / math.sqrt(heights.shape[-1])).ravel()


class FollowPath(CostTerm):
    """Be where a path says all along, passed at a steady pace."""

    weight: Float[Array, ""]
    structure: Structure = eqx.field(static=True)
    points: Float[Array, "K A"]
    shares: Float[Array, " K"]
    """Length of the path up to each point, as a share of the whole."""
    within: Float[Array, ""]
    axes: tuple[int, ...] = eqx.field(static=True)

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        position = read_pose(self.structure, trajectory.states[1:]).position[:, self.axes]
        share = jnp.arange(1, len(position) + 1) / len(position)
        columns = [jnp.interp(share, self.shares, column) for column in self.points.T]
        wanted = jnp.stack(columns, axis=-1)
        return math.sqrt(trajectory.dt) * ((position - wanted) / self.within).ravel()


class Travel(CostTerm):
    """Come `distance` [m] forward along `direction` by the end; further than possible means as far as possible."""

    weight: Float[Array, ""]
    structure: Structure = eqx.field(static=True)
    direction: Float[Array, " 3"]
    distance: Float[Array, ""]
    within: Float[Array, ""]

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        ends = trajectory.states[jnp.array([0, -1])]
        position = read_pose(self.structure, ends).position
        travelled = (position[1] - position[0]) @ self.direction
        return ((self.distance - travelled) / self.within)[None]


class KeepVelocity(CostTerm):
    """Move with a velocity, from a given time on."""

    weight: Float[Array, ""]
    structure: Structure = eqx.field(static=True)
    velocity: Float[Array, " A"]
    within: Float[Array, ""]
    axes: tuple[int, ...] = eqx.field(static=True)
    times: tuple[float, ...] = eqx.field(static=True)

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        states = _from(self.times, trajectory)
        velocity = read_pose(self.structure, states).velocity[:, self.axes]
        off = (velocity - self.velocity) / self.within
        return math.sqrt(trajectory.dt) * off.ravel()


class KeepSpeed(CostTerm):
    """Move forward, where the body points, at a speed, from a given time on."""

    weight: Float[Array, ""]
    structure: Structure = eqx.field(static=True)
    speed: Float[Array, ""]
    within: Float[Array, ""]
    times: tuple[float, ...] = eqx.field(static=True)

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        pose = read_pose(self.structure, _from(self.times, trajectory))
        speed = jnp.sum(pose.velocity * pose.forward, axis=-1)
        return math.sqrt(trajectory.dt) * (speed - self.speed) / self.within


class Point(CostTerm):
    """Point forward, or stand upright, along `direction`: at given times, or from the only one on if `lasts`."""

    weight: Float[Array, ""]
    structure: Structure = eqx.field(static=True)
    direction: Float[Array, " 3"]
    within: Float[Array, ""]
    """[rad]"""
    axis: str = eqx.field(static=True)
    """`forward` or `upward`."""
    lasts: bool = eqx.field(static=True)
    times: tuple[float, ...] = eqx.field(static=True)

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        if self.lasts:
            states = _from(self.times, trajectory)
            share = math.sqrt(trajectory.dt)
        else:
            states = trajectory.states[jnp.array(rows_at(self.times, trajectory))]
            share = 1.0
        pose = read_pose(self.structure, states)
        axis = getattr(pose, self.axis)
        off = (axis - self.direction) / self.within
        return share * off.ravel()


class StayUpright(CostTerm):
    """Keep the body's up near the world's, from a given time on: ∫ of the angle beyond a tolerance."""

    weight: Float[Array, ""]
    structure: Structure = eqx.field(static=True)
    tolerance: Float[Array, ""]
    """[rad] Leaning that costs nothing."""
    within: Float[Array, ""]
    """[rad]"""
    may_pitch: bool = eqx.field(static=True)
    """Whether only rolling counts, so that the body may dive and leap."""
    times: tuple[float, ...] = eqx.field(static=True)

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        pose = read_pose(self.structure, _from(self.times, trajectory))
        angle = lean(pose, may_pitch=self.may_pitch)
        beyond = jnp.maximum(angle - self.tolerance, 0)
        return math.sqrt(trajectory.dt) * beyond / self.within


def lean(pose: Pose, *, may_pitch: bool) -> Float[Array, " T"]:
    """Return by how much [rad] bodies lean: 0 upright, π upside down; by rolling alone if they `may_pitch`."""
    if may_pitch:
        aside = jnp.cross(pose.upward, pose.forward)[..., 2] ** 2
        along = jnp.sum(pose.upward * pose.forward, axis=-1)
        above = pose.upward[..., 2] - pose.forward[..., 2] * along
    else:
        aside = jnp.sum(pose.upward[..., :2] ** 2, axis=-1)
        above = pose.upward[..., 2]
    return jnp.atan2(jnp.sqrt(aside + NEARLY_UPRIGHT**2), above)


class StayWithin(CostTerm):
    """Keep state entries between bounds, such as joints: ∫ of what is beyond."""

    weight: Float[Array, ""]
    low: Float[Array, " E"]
    high: Float[Array, " E"]
    within: Float[Array, ""]
    entries: tuple[int, ...] = eqx.field(static=True)

    def residuals(self, trajectory: Trajectory) -> Float[Array, " R"]:
        values = trajectory.states[1:, self.entries]
        above = jnp.maximum(values - self.high, 0)
        below = jnp.maximum(self.low - values, 0)
        beyond = (above + below) / self.within
        return math.sqrt(trajectory.dt) * beyond.ravel()


def as_weight(weight: float) -> Array:
    """Return an array: another weight needs no other program."""
    return as_jax(weight)


def _from(times: tuple[float, ...], trajectory: Trajectory) -> Float[Array, "K S"]:
    """Return the states from the first of `times` on, all but the start if there is none; at least the last one."""
    first = 1
    if times:
        first = round(times[0] / trajectory.dt)
    last = len(trajectory.states) - 1
    return trajectory.states[max(1, min(first, last)) :]
