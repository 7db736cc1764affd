"""A short simulation of a model, by which it is known early that MuJoCo cannot simulate it."""

from __future__ import annotations

import time

import mujoco
import numpy as np
from numpy.random import (  # by name: the process that tries a model opens no file later on
    Generator,
    default_rng,
)

STARTS = 8
"""Number of states a model is tried from: its reference pose, then random ones."""

STEPS = 50
"""Number of physics steps from each state."""

HOLD = 10
"""Number of steps each random control is held."""

LONGEST = 1.0
"""Processor time after which a trial ends [s]: one step of some models takes a tenth of a second."""


def try_model(model: mujoco.MjModel) -> None:
    """Simulate a model from its reference pose and from random states, by random controls; raises mujoco.FatalError."""
    rng = default_rng(0)
    data = mujoco.MjData(model)
    until = time.process_time() + LONGEST
    starts = STARTS
    if model.nflex:
        starts = 1  # its nodes anywhere are no soft body any more
    for start in range(starts):
        mujoco.mj_resetData(model, data)
        if start:
            # Along the velocities' axes, so that orientations stay unit quaternions.
            mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
            data.qvel[:] = rng.normal(size=model.nv)
        for step in range(STEPS):
            if step % HOLD == 0:
                data.ctrl[:] = _random_controls(model, rng)
            mujoco.mj_step(model, data)
            if time.process_time() > until:
                return


def _random_controls(model: mujoco.MjModel, rng: Generator) -> np.ndarray:
    """Return controls anywhere in their ranges, or about 0 where there are none."""
    low, high = model.actuator_ctrlrange.T
    is_limited = model.actuator_ctrllimited.astype(bool)
    return np.where(is_limited, rng.uniform(low, high), rng.normal(size=model.nu))
