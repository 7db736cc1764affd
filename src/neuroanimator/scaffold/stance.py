"""Whether a root that may fall is upright and in the air: data should show what a body does, not how it lies."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.scaffold.holding import HOLD_SECONDS, Hold, at
from neuroanimator.scaffold.surroundings import gravity_of
from neuroanimator.systems.rigid.model_system import ModelSystem
from neuroanimator.systems.rigid.warnings import warnings_counted

MAX_LEAN = 1.0
"""Largest angle between a root's up axis and where that points at rest at which the root counts as upright [rad]."""


STAND_SECONDS = 2.0
"""A root that is still upright after this time under the controls that hold it is held by them [s]."""


class Posture(NamedTuple):
    """What each of some states (*B, S) looks like."""

    is_upright: Bool[np.ndarray, " *B"]
    """Whether the root leans by less than `MAX_LEAN`, and does not lie on the ground unless it does so at rest."""
    is_airborne: Bool[np.ndarray, " *B"]
    """Whether nothing touches the ground."""


class Stance(NamedTuple):
    """How a root that may fall stands at rest."""

    up: Float[np.ndarray, " 3"]
    """The root's axis that points up at rest."""
    lies: bool
    """Whether the root itself is on the ground at rest."""
    hovers: bool
    """Whether its controls hold it in the air."""
    is_held: bool
    """Whether it stays upright under the controls that hold it: where it does not, gentler ones are of no help."""


def stance_of(system: ModelSystem, hold: Hold) -> Stance | None:
    """Return how the root stands at rest, a moment after `hold` took it over; None for one that cannot fall."""
    model = system.model
    if not system.sampling.above_ground or not gravity_of(model).any():
        return None
    with warnings_counted:
        data = at(model, system.rest[: system.physical_size], hold.controls)
        up = data.xmat[_root(model)].reshape(3, 3)[2].copy()
        touching = _touching_after(model, data, HOLD_SECONDS)
        lies = _root(model) in touching
        hovers = bool(hold.source) and not touching.size
        touching = _touching_after(model, data, STAND_SECONDS - HOLD_SECONDS)
        is_held = _is_upright(model, data, touching, up, lies)
    return Stance(up, lies, hovers, is_held)


def _touching_after(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> np.ndarray:
    """Return the bodies on the ground when `data` has been stepped on for so long [s]."""
    mujoco.mj_step(model, data, max(1, round(seconds / model.opt.timestep)))
    mujoco.mj_fwdPosition(model, data)
    return _bodies_on_ground(model, data)


def posture_of(
    system: ModelSystem, stance: Stance | None, states: Float[np.ndarray, "*B S"]
) -> Posture:
    """Return the posture of a root in each of `states`; what cannot fall is upright, on no ground."""
    shape = states.shape[:-1]
    is_upright = np.ones(shape, bool)
    is_airborne = np.ones(shape, bool)
    if stance is None:
        return Posture(is_upright, is_airborne)
    model = system.model
    data = mujoco.MjData(model)
    with warnings_counted:
        for row in np.ndindex(shape):
            system.put(data, states[row])
            mujoco.mj_fwdPosition(model, data)
            touching = _bodies_on_ground(model, data)
            is_upright[row] = _is_upright(model, data, touching, stance.up, stance.lies)
            is_airborne[row] = not touching.size
    return Posture(is_upright, is_airborne)


def _is_upright(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    touching: np.ndarray,
    up: Float[np.ndarray, " 3"],
    lies: bool,
) -> bool:
    """Return whether the root, of which `up` points up at rest, does so still and does not lie as it did not at rest."""
    root = _root(model)
    height = data.xmat[root].reshape(3, 3)[2] @ up
    return bool(height > np.cos(MAX_LEAN)) and (lies or root not in touching)


def _root(model: mujoco.MjModel) -> int:
    """Return the body that the first joint's tree begins with."""
    return int(model.body_rootid[model.jnt_bodyid[0]])


def _bodies_on_ground(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the bodies that touch something fixed."""
    bodies = model.body_weldid[model.geom_bodyid[data.contact.geom]].reshape(-1, 2)
    return bodies[(bodies == 0).any(axis=1)].max(axis=1)
