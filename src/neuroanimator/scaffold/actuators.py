"""What a model's actuators should be allowed, read off the model, and models that nothing drives."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.scaffold.defaults import tidy
from neuroanimator.scaffold.surroundings import servo_of
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.rigid.actuators import actuator_name, control_range
from neuroanimator.systems.rigid.touching import is_disabled

GUESS = (-1.0, 1.0)
"""An actuator of which nothing is known is proposed this range, with a word to correct it."""

ANY = 1e4
"""An actuator of which the model gives no range might have to push so hard to hold it."""

HALF_TURN = (-3.1416, 3.1416)
"""A servo of a hinge without a range is proposed this one [rad]."""


def actuator_faults(path: Path, model: mujoco.MjModel) -> str:
    """Return why nothing drives the model, and what to do; empty if something does."""
    if is_disabled(model, mujoco.mjtDisableBit.mjDSBL_ACTUATION):
        return f'{path.name}: <flag actuation="disable"/> switches all actuators off. Remove it.'
    if model.nu:
        return ""
    how = "Add an <actuator> section: something must drive the model."
    if path.suffix.lower() == ".urdf":
        how = (
            'Motors are made of <limit effort="..." velocity="..."/> with an effort above 0: give one to each joint that '
            "is driven."
        )
    return f"{path.name} has no actuators. {how}"


def proposed_bounds(model: mujoco.MjModel) -> dict[str, tuple[float, float]]:
    """Return the least and the largest control of each actuator: the model's own, else what it can be guessed from."""
    bounds = {}
    for actuator in range(model.nu):
        bound = control_range(model, actuator)
        if bound is None or not bound[0] < bound[1]:
            bound = _guessed(model, actuator)
        bounds[actuator_name(model, actuator)] = bound
    return bounds


def possible_controls(
    model: mujoco.MjModel, bounds: Bounds
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"]]:
    """Return the least and the largest controls that might hold the model: `bounds`, but any where it gives no range."""
    is_limited = np.array([control_range(model, i) is not None for i in range(model.nu)], bool)
    low = np.where(is_limited, bounds.low, np.minimum(bounds.low, -ANY))
    high = np.where(is_limited, bounds.high, np.maximum(bounds.high, ANY))
    return low, high


def wide_enough(
    model: mujoco.MjModel, bounds: dict[str, tuple[float, float]], held: Float[np.ndarray, " C"]
) -> dict[str, tuple[float, float]]:
    """Return the bounds, guessed ones wide enough to hold the model with half of them by the controls `held`."""
    wide = {}
    for actuator, (name, (low, high)) in enumerate(bounds.items()):
        wide[name] = (low, high)
        if control_range(model, actuator) is None and not servo_of(model, actuator):
            needed = tidy(2 * abs(float(held[actuator])), 2)
            wide[name] = (min(low, -needed), max(high, needed))
    return wide


def _guessed(model: mujoco.MjModel, actuator: int) -> tuple[float, float]:
    """Return a range for an actuator without one: of its joint for a servo, of its forces for a motor."""
    joint = -1
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        joint = int(model.actuator_trnid[actuator][0])
    if servo_of(model, actuator) and joint >= 0:
        if model.jnt_limited[joint]:
            low, high = model.jnt_range[joint]
            return float(low), float(high)
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            return HALF_TURN
        return GUESS
    gain = abs(float(model.actuator_gainprm[actuator][0]))
    if model.actuator_forcelimited[actuator] and gain > 0:
        low, high = model.actuator_forcerange[actuator] / gain
        return float(low), float(high)
    gear = abs(float(model.actuator_gear[actuator][0]))
    if joint >= 0 and model.jnt_actfrclimited[joint] and gain * gear > 0:
        low, high = np.array(model.jnt_actfrcrange[joint]) / (gain * gear)
        return float(low), float(high)
    return GUESS
