"""Which parts of a MuJoCo model can touch, and the features its flags turn off."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Bool, Int

FLAT = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
"""Types of geoms that never touch one another."""


def is_disabled(model: mujoco.MjModel, *flags: mujoco.mjtDisableBit) -> bool:
    """Return whether the model's <flag> element turns any of `flags` off."""
    return any(model.opt.disableflags & flag for flag in flags)


def is_limited(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a joint's range is enforced: the model's flags may turn all ranges off."""
    off = is_disabled(
        model, mujoco.mjtDisableBit.mjDSBL_LIMIT, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    )
    return bool(model.jnt_limited[joint]) and not off


def touching_geoms(model: mujoco.MjModel) -> Int[np.ndarray, "P 2"]:
    """Return the pairs of geoms that MuJoCo would let collide in any pose ("Collision detection")."""
    nothing = np.zeros((0, 2), int)
    if is_disabled(
        model, mujoco.mjtDisableBit.mjDSBL_CONTACT, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    ):
        return nothing
    matches = (model.geom_contype[:, None] & model.geom_conaffinity[None]) != 0
    can_touch = (matches | matches.T) & ~_are_one_body(model) & ~_are_flat(model)
    for signature in model.exclude_signature:
        first, second = divmod(int(signature), 1 << 16)
        is_first = model.geom_bodyid == first
        is_second = model.geom_bodyid == second
        can_touch &= ~(is_first[:, None] & is_second[None] | is_second[:, None] & is_first[None])
    pairs = np.argwhere(np.triu(can_touch, 1))
    explicit = np.stack([model.pair_geom1, model.pair_geom2], axis=1).astype(int)
    return np.concatenate([pairs, explicit]) if len(explicit) else pairs


def _are_one_body(model: mujoco.MjModel) -> Bool[np.ndarray, "G G"]:
    """Return which geoms MuJoCo never lets collide, as they move together or belong to parent and child."""
    body = model.body_weldid[model.geom_bodyid]
    parent = model.body_weldid[model.body_parentid[body]]
    is_same = body[:, None] == body[None]
    if is_disabled(model, mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        return np.asarray(is_same)
    # Children of the world may touch it.
    hangs_on = (parent[:, None] == body[None]) & (body[None] != 0)
    return np.asarray(is_same | hangs_on | hangs_on.T)


def _are_flat(model: mujoco.MjModel) -> Bool[np.ndarray, "G G"]:
    is_flat = np.isin(model.geom_type, [int(kind) for kind in FLAT])
    return np.asarray(is_flat[:, None] & is_flat[None])
