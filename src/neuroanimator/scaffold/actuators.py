"""Ranges of a model's actuators, from the model or guessed, and models that nothing drives."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.scaffold.defaults import rounded
from neuroanimator.scaffold.root_invariance import is_servo
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.rigid.actuators import actuator_name, control_range
from neuroanimator.systems.rigid.touching import is_disabled

GUESS = (-1.0, 1.0)
"""Range proposed for an actuator without any information."""

ANY = 1e4
"""Largest control tried to hold a model, for an actuator without a range."""

HALF_TURN = (-3.1416, 3.1416)
"""Range proposed for a servo of a hinge without one [rad]."""


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


def actuators_without_range(model: mujoco.MjModel) -> list[int]:
    """Return the actuators without a range in the model."""
    return [i for i in range(model.nu) if control_range(model, i) is None]


def proposed_bounds(model: mujoco.MjModel) -> dict[str, tuple[float, float]]:
    """Return the smallest and the largest control of each actuator: the model's own, else a guess."""
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
    """Return the smallest and the largest controls that might hold the model: `bounds`, or ±`ANY` where it gives no range."""
    low = np.array(bounds.low)
    high = np.array(bounds.high)
    unlimited = actuators_without_range(model)
    low[unlimited] = np.minimum(low[unlimited], -ANY)
    high[unlimited] = np.maximum(high[unlimited], ANY)
    return low, high


def widen_guesses(
    model: mujoco.MjModel, bounds: dict[str, tuple[float, float]], held: Float[np.ndarray, " C"]
) -> None:
    """Widen guessed bounds so that half of them covers the controls `held` that hold the model."""
    for actuator in actuators_without_range(model):
        if not is_servo(model, actuator):
            name = actuator_name(model, actuator)
            low, high = bounds[name]
            needed = rounded(2 * abs(float(held[actuator])), 2)
            bounds[name] = (min(low, -needed), max(high, needed))


def _guessed(model: mujoco.MjModel, actuator: int) -> tuple[float, float]:
    """Return a range for an actuator without one: that of its joint for a servo, of its forces for a motor."""
    joint = -1
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        joint = int(model.actuator_trnid[actuator][0])
    if is_servo(model, actuator) and joint >= 0:
        if model.jnt_limited[joint]:
            return tuple(model.jnt_range[joint].tolist())
        is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        return HALF_TURN if is_hinge else GUESS
    gain = abs(float(model.actuator_gainprm[actuator][0]))
    if model.actuator_forcelimited[actuator] and gain > 0:
        return tuple((model.actuator_forcerange[actuator] / gain).tolist())
    gain *= abs(float(model.actuator_gear[actuator][0]))
    if joint >= 0 and model.jnt_actfrclimited[joint] and gain > 0:
        return tuple((model.jnt_actfrcrange[joint] / gain).tolist())
    return GUESS
