"""A short simulation of a model, to find out early if MuJoCo cannot simulate it."""

from __future__ import annotations

import time

import mujoco
import numpy as np
from numpy.random import (  # by name: the process that tries a model cannot open files later
    Generator,
    default_rng,
)

STARTS = 8
"""Number of states from which a model is tried: its reference pose, then random ones."""

STEPS = 50
"""Number of physics steps from each state."""

HOLD = 10
"""Number of steps for which each random control is held."""

LONGEST = 1.0
"""Processor time after which a trial ends [s]: one step of some models takes a tenth of a second."""


def try_model(model: mujoco.MjModel) -> None:
    """Simulate a model from its reference pose and from random states, by random controls; raises mujoco.FatalError."""
    rng = default_rng(0)
    data = mujoco.MjData(model)
    until = time.process_time() + LONGEST
    starts = STARTS
    if model.nflex:
        starts = 1  # a soft body with scattered nodes is none
    for start in range(starts):
        mujoco.mj_resetData(model, data)
        if start:
            # In the space of velocities, so that orientations stay unit quaternions.
            mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
            data.qvel[:] = rng.normal(size=model.nv)
        for step in range(STEPS):
            if step % HOLD == 0:
                data.ctrl[:] = _random_controls(model, rng)
            mujoco.mj_step(model, data)
            if time.process_time() > until:
                return


def _random_controls(model: mujoco.MjModel, rng: Generator) -> np.ndarray:
    """Return random controls in their ranges, or about 0 without a range."""
    low, high = model.actuator_ctrlrange.T
    is_limited = model.actuator_ctrllimited.astype(bool)
    return np.where(is_limited, rng.uniform(low, high), rng.normal(size=model.nu))
