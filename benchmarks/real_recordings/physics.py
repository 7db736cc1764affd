"""Rollouts of a model's true physics from many starts at once, by MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import rollout


def simulate(
    model: mujoco.MjModel,
    starts: Float[np.ndarray, "W S"],
    controls: Float[np.ndarray, "W T C"],
    dt: float,
) -> Float[np.ndarray, "W T+1 S"]:
    """Return the states every `dt` seconds, of which the model's step is a whole part; the starts come first.

    Controls act for `dt` each; those the recording has none of are zero.
    """
    windows, steps, recorded = controls.shape
    substeps = round(dt / model.opt.timestep)
    whole = np.zeros((windows, steps * substeps, model.nu))
    whole[:, :, :recorded] = np.repeat(controls, substeps, axis=1)
    data = mujoco.MjData(model)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    initial = np.zeros((windows, size))
    initial[:, 1 : 1 + starts.shape[1]] = starts  # behind the time; positions, then velocities
    states, _ = rollout.rollout(model, [data], initial, whole)
    kept = states[:, substeps - 1 :: substeps, 1 : 1 + starts.shape[1]]
    return np.concatenate([starts[:, None], kept], axis=1)
