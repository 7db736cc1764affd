"""Starts that lie in the ground, lifted out of it."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.physics.rigid.warnings import warnings_counted

VERTICAL = 1 - 1e-6
"""Smallest dot product of a slide's axis and the vertical for it to be vertical."""

LIFTS = 3
"""Maximum number of times a start is lifted: out of one obstacle, it may be in another."""


def height_entry(model: mujoco.MjModel) -> int | None:
    """Return the state entry of the first root's height, of a free joint or an upright slide; None if there is none."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = model.body_rootid[model.jnt_bodyid[0]]
    for joint in range(model.njnt):
        entry = int(model.jnt_qposadr[joint])
        if model.jnt_bodyid[joint] != root:
            continue
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            return entry + 2
        is_slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        if is_slide and data.xaxis[joint][2] > VERTICAL:
            return entry
    return None


def lift_out(model: mujoco.MjModel, entry: int, states: Float[np.ndarray, "B S"]) -> None:
    """Raise the height in state entry `entry` of each state in which a body lies in something fixed."""
    data = mujoco.MjData(model)
    with warnings_counted:
        for state in states:
            for _ in range(LIFTS):
                mujoco.mj_resetData(model, data)
                data.qpos[:] = state[: model.nq]
                mujoco.mj_fwdPosition(model, data)
                depth = depth_in_ground(model, data)
                if depth <= 0:
                    break
                state[entry] += depth


def depth_in_ground(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the depth of the deepest contact with something fixed [m]; 0 if there is none."""
    if not data.ncon:
        return 0.0
    bodies = model.body_weldid[model.geom_bodyid[data.contact.geom]]
    is_fixed = (bodies == 0).any(axis=1)
    return float(max(0.0, -np.min(data.contact.dist, initial=0.0, where=is_fixed)))
