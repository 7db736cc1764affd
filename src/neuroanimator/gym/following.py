"""Following a recorded motion, as rules of episodes: they begin on it, at any of its phases, and end where it is lost.

Rewards are exponentials of the body's distance from the motion, as in DeepMimic (Peng and others, SIGGRAPH 2018):

    r = Σ w exp(−k e),  e: squared errors of angles, of their velocities, of the parts' positions about the root, of the
                           root and of its velocity; sliding speeds of the feet, if the task names them
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float

from neuroanimator.appearance.skeleton import kinematics_of
from neuroanimator.control.policies.reference_motion import (
    ORIENTATION,
    POSITION,
    ReferenceMotion,
)
from neuroanimator.definitions.follow import FollowTable
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.errors import ArgumentError
from neuroanimator.gym.disturbances import disturbance_of
from neuroanimator.gym.rules import EpisodeRules, never
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.kinematics import Kinematics
from neuroanimator.state.rotation import conjugate, multiply, rotate


class Term(NamedTuple):
    """A term of the reward: weight · exp(−sharpness · error)."""

    weight: float
    sharpness: float


ANGLES = Term(0.35, 2.0)
"""Term of the sum of squared errors of angles [rad²]."""

RATES = Term(0.1, 0.005)
"""Term of the sum of squared errors of their velocities [rad²/s²]."""

PARTS = Term(0.15, 60.0)
"""Term of the mean squared error of the parts' positions about the root [m²]."""

ROOT = Term(0.3, 20.0)
"""Term of the squared error of the root's position [m²], plus `TILT_SHARE` times that of its orientation [rad²]."""

ROOT_VELOCITY = Term(0.1, 1.0)
"""Term of the squared error of its velocity [m²/s²], plus `TURNING_SHARE` times that of its angular velocity [rad²/s²]."""

FEET = Term(0.15, 300.0)
"""Term of the sum of squared errors of the feet's heights [m²], if the task names feet; the other terms share the rest."""

SLIDING = Term(0.2, 8.0)
"""Term of the sum of the feet's sliding speeds [m/s], if the task names feet."""

FLOOR = 0.01
"""Height over which a point of a foot gradually stops counting as on the floor [m]."""

TINY = 1e-12
"""Squared speed added so that the gradient at zero is finite [m²/s²]."""

FOOT = 0.15
"""Distance of a foot's ends from its joint, which turns its tilt into a height [m]."""

PATH_TIME = 0.4
"""Time over which an error of velocity counts as one of position, if commands leave the motion without a path [s]."""

TILT_SHARE = 0.25

TURNING_SHARE = 0.1


class Following(eqx.Module):
    """Rewards of a body that follows a motion, and whether it has lost it."""

    motion: ReferenceMotion
    kinematics: Kinematics = eqx.field(static=True)
    trunk: int = eqx.field(static=True)
    """Number of the link whose tilt counts."""
    feet: tuple[int, ...] = eqx.field(static=True)
    """Numbers of the links that are feet."""
    soles: Float[Array, "F P 3"]
    """Points of these links that may touch the floor, each in the frame of its link [m]."""
    lost_distance: float = eqx.field(static=True)
    lost_tilt: float = eqx.field(static=True)

    @classmethod
    def of(cls, motion: ReferenceMotion, system: MujocoSystem, table: FollowTable) -> Following:
        """Return the rewards for a system's body; ArgumentError for a trunk that is not one of its parts."""
        bones = system.skeleton.bones
        names = [bone.name for bone in bones]
        for label, parts in {"trunk": (table.trunk,), "feet": table.feet}.items():
            for part in parts:
                if part not in names:
                    valid = ", ".join(names)
                    raise ArgumentError(f"follow.{label}: no part called '{part}'. Parts: {valid}.")
        kinematics = kinematics_of(bones)
        return cls(
            motion,
            kinematics,
            names.index(table.trunk),
            tuple(names.index(foot) for foot in table.feet),
            as_jax(_soles(system.model, table.feet)),
            table.lost_distance,
            table.lost_tilt,
        )

    def reward(self, following: Float[Array, "*B S"]) -> Float[Array, " *B"]:
        """Return the rewards of steps that lead to these states, from 0 to 1."""
        motion = self.motion
        wanted = motion.frame(following)
        off = following - wanted
        angles = (off[..., np.array(motion.hinges)] ** 2).sum(axis=-1)
        rates = (off[..., np.array(motion.rates)] ** 2).sum(axis=-1)
        placed = link_poses(self.kinematics, following)
        aimed = link_poses(self.kinematics, wanted)
        parts = _about_root(placed, following) - _about_root(aimed, wanted)
        relative = multiply(conjugate(wanted[..., ORIENTATION]), following[..., ORIENTATION])
        turned = 4 * (relative[..., 1:] ** 2).sum(axis=-1)
        distance = (off[..., POSITION] ** 2).sum(axis=-1)
        first = motion.velocity
        moving = (off[..., first : first + 3] ** 2).sum(axis=-1)
        if motion.commands is not None:
            distance += PATH_TIME**2 * (off[..., first : first + 2] ** 2).sum(axis=-1)
        turning = (off[..., first + 3 : first + 6] ** 2).sum(axis=-1)
        earned = (
            _paid(ANGLES, angles)
            + _paid(RATES, rates)
            + _paid(PARTS, (parts**2).sum(axis=-1).mean(axis=-1))
            + _paid(ROOT, distance + TILT_SHARE * turned)
            + _paid(ROOT_VELOCITY, moving + TURNING_SHARE * turning)
        )
        if not self.feet:
            return earned
        # The heights of a foot's points follow from these.
        lifted = jnp.stack(
            [placed[foot][..., 2, :] - aimed[foot][..., 2, :] for foot in self.feet], axis=-2
        )
        levers = jnp.asarray([FOOT, FOOT, 0, 1], following.dtype)
        error = ((levers * lifted) ** 2).sum(axis=(-2, -1))
        return (1 - FEET.weight) * earned + _paid(FEET, error)

    def sliding(
        self, states: Float[Array, "*B S"], following: Float[Array, "*B S"], dt: float
    ) -> Float[Array, " *B"]:
        """Return the sum over feet of the mean speed along the floor [m/s] between states `dt` seconds apart.

        Points are weighted by their closeness to the floor, before and after.
        """
        before = self._placed_soles(states)
        after = self._placed_soles(following)
        moved = (after - before)[..., :2] / dt
        speeds = jnp.sqrt((moved**2).sum(axis=-1) + TINY)
        heights = jnp.maximum(before[..., 2], after[..., 2])
        is_down = jnp.exp(-jnp.maximum(heights, 0) / FLOOR)
        return (is_down * speeds).mean(axis=-1).sum(axis=-1)

    def _placed_soles(self, states: Float[Array, "*B S"]) -> Float[Array, "*B F P 3"]:
        placed = link_poses(self.kinematics, states)
        feet = jnp.stack([placed[foot][..., :3, :] for foot in self.feet], axis=-3)
        turned = (feet[..., None, :, :3] * self.soles[:, :, None, :]).sum(axis=-1)
        return turned + feet[..., None, :, 3]

    def distance(self, states: Float[Array, "*B S"]) -> Float[Array, " *B"]:
        """Return the distance of the root from the motion's [m]."""
        off = states[..., POSITION] - self.motion.frame(states)[..., POSITION]
        return jnp.sqrt((off**2).sum(axis=-1))

    def tilt(self, states: Float[Array, "*B S"]) -> Float[Array, " *B"]:
        """Return the angle between the trunk and the motion's [rad]."""
        trunks = link_poses(self.kinematics, states)[self.trunk][..., :3, :3]
        frames = self.motion.frame(states)
        wanted = link_poses(self.kinematics, frames)[self.trunk][..., :3, :3]
        # The trace of R₁ᵀ R₂ is 1 + 2 cos of the angle between them.
        cosine = ((trunks * wanted).sum(axis=(-2, -1)) - 1) / 2
        return jnp.arccos(jnp.clip(cosine, -1, 1))

    def is_lost(self, states: Float[Array, "*B S"]) -> Bool[Array, " *B"]:
        """Return whether the body is farther from the motion than the task allows."""
        is_far = self.distance(states) > self.lost_distance
        return is_far | (self.tilt(states) > self.lost_tilt)


_lost = eqx.filter_jit(Following.is_lost)


def link_poses(
    kinematics: Kinematics, states: Float[Array, "*B S"]
) -> list[Float[Array, "*B 4 4"]]:
    """Return for each link the matrix from its frame to the world; unused parts are not computed."""
    transforms = kinematics.transforms(states)
    placed = []
    for link in kinematics.carried:
        matrix = jnp.asarray(link.matrix, states.dtype)
        if link.frame >= 0:
            matrix = (transforms[link.frame][..., :, :, None] * matrix).sum(axis=-2)
        placed.append(jnp.broadcast_to(matrix, (*states.shape[:-1], 4, 4)))
    return placed


def following_rules(
    table: FollowTable, motion: ReferenceMotion, system: MujocoSystem
) -> EpisodeRules:
    """Return the rules of following `motion`. ArgumentError for a trunk that is not one of the body's parts."""
    following = Following.of(motion, system, table)
    frames = np.asarray(motion.frames, float)
    kept = replace(motion, frames=frames)
    # A motion that is not repeated has a last pose, and nothing after it.
    starts = motion.lap
    steps = table.laps * motion.lap
    if table.laps > 1 and motion.commands is None:
        steps -= motion.lap - 1

    def reward(
        states: Float[AnyArray, "... S"],
        controls: Float[AnyArray, "... C"],
        after: Float[AnyArray, "... S"],
        dt: float,
    ) -> Float[AnyArray, " ..."]:
        before = jnp.asarray(states, jnp.float32)
        return _rewards(following, before, jnp.asarray(after, jnp.float32), dt)

    def is_over(states: Float[np.ndarray, "B S"]) -> Bool[np.ndarray, " B"]:
        return np.asarray(_lost(following, as_jax(states)))

    def is_cut(states: Float[np.ndarray, "B S"]) -> Bool[np.ndarray, " B"]:
        if motion.commands is not None:
            return never(states)
        return np.asarray(motion.index(as_jax(states))) >= len(frames) - 1

    def draw_start(rng: np.random.Generator) -> Float[np.ndarray, " S"]:
        start = frames[rng.integers(0, starts)].copy()
        if motion.commands is not None:
            told = motion.commands.draw(rng, start[None])
            start = kept.frame(told)[0]
        hinges = list(motion.hinges)
        start[hinges] += rng.uniform(-table.reset_noise, table.reset_noise, len(hinges))
        start[ORIENTATION] /= np.linalg.norm(start[ORIENTATION])
        return start

    return EpisodeRules(
        reward,
        is_over=is_over,
        is_cut=is_cut,
        draw_start=draw_start,
        steps=steps,
        disturb=disturbance_of(table, motion, system),
    )


@eqx.filter_jit
def _rewards(
    following: Following, states: Float[Array, "*B S"], after: Float[Array, "*B S"], dt: float
) -> Float[Array, " *B"]:
    earned = following.reward(after)
    if not following.feet:
        return earned
    sliding = _paid(SLIDING, following.sliding(states, after, dt))
    return (1 - SLIDING.weight) * earned + sliding


def _paid(term: Term, error: Float[Array, " *B"]) -> Float[Array, " *B"]:
    return term.weight * jnp.exp(-term.sharpness * error)


def _soles(model: mujoco.MjModel, feet: tuple[str, ...]) -> Float[np.ndarray, "F P 3"]:
    """Return the corners of the boxes around the shapes of each foot; a foot with fewer than others repeats some."""
    if not feet:
        return np.zeros((0, 0, 3))
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    soles = []
    for foot in feet:
        points = []
        body = model.body(foot)
        for geom in range(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0])):
            centre, half = np.split(model.geom_aabb[geom], 2)
            quaternion = np.array(model.geom_quat[geom])
            points.append(model.geom_pos[geom] + rotate(quaternion, centre + half * corners))
        soles.append(np.concatenate(points or [np.zeros((1, 3))]))
    most = max(len(points) for points in soles)
    return np.array([np.resize(points, (most, 3)) for points in soles])


def _about_root(
    placed: list[Float[Array, "*B 4 4"]], states: Float[Array, "*B S"]
) -> Float[Array, "*B L 3"]:
    positions = jnp.stack([matrix[..., :3, 3] for matrix in placed], axis=-2)
    return positions - states[..., None, POSITION]
