"""Strides between those of two gaits, or beyond the faster one, by interpolating feet and solving inverse kinematics for legs.

The slower gait may be standing. The pose of a foot relative to the root is interpolated between the two gaits, or extrapolated,
so a foot on the floor in both stays on it, at a speed between theirs. On strides shorter than a walk's, feet are lifted by the
square root of the share, to clear the floor.
"""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.state.rotation import of_unit_length

STEPS = 40
"""Number of inverse kinematics steps per pose."""

DAMPING = 1e-3
"""Damping of these steps, for straight legs that cannot reach farther [m²]."""

HEIGHT = 2

HEIGHT_DOF = 2
"""Velocity of a free root along the vertical."""

ROOT_DOFS = 6


def mixed_strides(
    model: mujoco.MjModel,
    slow: Float[np.ndarray, "L S"],
    fast: Float[np.ndarray, "L S"],
    share: float,
    lifting: float,
    feet: tuple[str, ...],
    dt: float,
    clock: int,
) -> Float[np.ndarray, "L S"]:
    """Return a lap interpolated between a slow gait (a share of 0) and a fast one (1), all at the same clock rate.

    A share above 1 extrapolates beyond the fast gait; no foot comes lower than in the two. Roots are at the origin with heading
    zero; heights of feet are interpolated by `lifting` instead of `share`. `dt` is the time between states of a lap [s], `clock`
    the entry of the clock's angle.
    """
    states = slow + share * (fast - slow)
    states[:, clock] = fast[:, clock]
    positions = states[:, : model.nq]
    positions[:, 3:7] = of_unit_length(positions[:, 3:7])
    data = mujoco.MjData(model)
    bodies = [model.body(foot).id for foot in feet]
    for row in range(len(fast)):
        slower = _foot_poses(model, data, slow[row, : model.nq], bodies)
        away = _foot_poses(model, data, fast[row, : model.nq], bodies) - slower
        wanted = slower + share * away
        lifted = lifting * away[:, HEIGHT]
        wanted[:, HEIGHT] = slower[:, HEIGHT] + np.maximum(lifted, np.minimum(away[:, HEIGHT], 0))
        wanted[:, 3:] = of_unit_length(wanted[:, 3:])
        for _ in range(STEPS):
            _reach_nearer(model, data, positions[row], wanted, bodies)
    rates = np.empty((len(fast), model.nv))
    following = np.roll(positions, -1, axis=0)
    before = np.roll(positions, 1, axis=0)
    for row in range(len(fast)):
        mujoco.mj_differentiatePos(model, rates[row], 2 * dt, before[row], following[row])
    # The root stays at the origin, so its velocity along the ground does not follow from its positions.
    velocities = states[:, model.nq :]
    velocities[:, ROOT_DOFS:] = rates[:, ROOT_DOFS:]
    velocities[:, HEIGHT_DOF] = rates[:, HEIGHT_DOF]
    beside = fast[:, model.nq :] == fast[0, model.nq :]
    velocities[:] = np.where(beside.all(axis=0), fast[:, model.nq :], velocities)
    return states


def _foot_poses(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    position: Float[np.ndarray, " Q"],
    feet: list[int],
) -> Float[np.ndarray, "F 7"]:
    """Return position and quaternion of each of the bodies `feet`, with signs such that w is not negative."""
    data.qpos[:] = position
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    quaternions = data.xquat[feet]
    signs = np.where(quaternions[:, :1] < 0, -1.0, 1.0)
    return np.concatenate([data.xpos[feet], signs * quaternions], axis=1)


def _reach_nearer(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    position: Float[np.ndarray, " Q"],
    wanted: Float[np.ndarray, "F 7"],
    feet: list[int],
) -> None:
    """Move the feet nearer to their wanted poses by hinges and the root's height: one step of damped least squares."""
    if not feet:
        return
    poses = _foot_poses(model, data, position, feet)
    error = np.zeros((len(feet), 6))
    error[:, :3] = wanted[:, :3] - poses[:, :3]
    jacobians = np.zeros((len(feet), 6, model.nv))
    for foot, pose, aim, turned, jacobian in zip(
        feet, poses, wanted, error[:, 3:], jacobians, strict=True
    ):
        mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], foot)
        mujoco.mju_subQuat(turned, aim[3:], pose[3:])
        mujoco.mju_rotVecQuat(turned, turned.copy(), pose[3:])
    jacobian = jacobians.reshape(error.size, model.nv)
    held = [dof for dof in range(ROOT_DOFS) if dof != HEIGHT_DOF]
    jacobian[:, held] = 0
    damped = jacobian @ jacobian.T + DAMPING * np.eye(error.size)
    step = jacobian.T @ np.linalg.solve(damped, error.ravel())
    mujoco.mj_integratePos(model, position, step, 1.0)
    for joint in range(model.njnt):
        if model.jnt_limited[joint]:
            entry = model.jnt_qposadr[joint]
            position[entry] = np.clip(position[entry], *model.jnt_range[joint])
