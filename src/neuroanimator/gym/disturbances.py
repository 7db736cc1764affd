"""Disturbances of a body between steps while a policy learns to follow a motion: new commands, and pushes of the trunk."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.control.policies.reference_motion import TURN, ReferenceMotion
from neuroanimator.definitions.follow import FollowTable
from neuroanimator.gym.rules import Disturbance
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem

FREE_VELOCITY = 6
"""Size of a free root's velocity."""


def disturbance_of(
    table: FollowTable, motion: ReferenceMotion, system: MujocoSystem
) -> Disturbance | None:
    """Return the disturbance of a task; None if it has none."""
    if table.commands is None and table.pushes is None:
        return None
    dt = table.hold * system.physics_dt

    def disturb(
        rng: np.random.Generator, states: Float[np.ndarray, "B S"]
    ) -> Float[np.ndarray, "B S"]:
        if table.commands is not None and motion.commands is not None:
            is_told = rng.random(len(states)) < dt / table.commands.interval
            told = motion.commands.draw_change(rng, states)
            states = np.where(is_told[:, None], told, states)
        if table.pushes is not None:
            is_pushed = rng.random(len(states)) < dt / table.pushes.interval
            impulses = table.pushes.impulse * rng.random(len(states)) * is_pushed
            states = pushed(system.model, table.trunk, states, impulses, rng)
        return states

    return disturb


def pushed(
    model: mujoco.MjModel,
    body: str,
    states: Float[np.ndarray, "B S"],
    impulses: Float[np.ndarray, " B"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "B S"]:
    """Return the states after an impulse [N s] each on the centre of mass of `body`, in random horizontal directions.

    The root is free and the first joint. Its velocity changes at once by that of a rigid body in this pose, M⁻¹ Jᵀ p of
    its six coordinates, as servos hold the rest.
    """
    moved = states.copy()
    data = mujoco.MjData(model)
    number = model.body(body).id
    jacobian = np.zeros((3, model.nv))
    inertia = np.zeros((model.nv, model.nv))
    free = slice(FREE_VELOCITY)
    for row in np.flatnonzero(impulses):
        data.qpos[:] = states[row, : model.nq]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_fullM(model, data, inertia)
        mujoco.mj_jacBodyCom(model, data, jacobian, None, number)
        angle = rng.uniform(0, TURN)
        impulse = impulses[row] * np.array([np.cos(angle), np.sin(angle), 0.0])
        change = np.linalg.solve(inertia[free, free], impulse @ jacobian[:, free])
        moved[row, model.nq : model.nq + FREE_VELOCITY] += change
    return moved
