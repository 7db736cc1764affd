"""Ranges of a model's actuators, from the model or guessed, and models that nothing drives."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.physics.rigid.actuators import (
    actuators_of_controls,
    control_names,
    control_range,
)
from neuroanimator.physics.rigid.touching import is_disabled
from neuroanimator.scaffold.defaults import rounded
from neuroanimator.scaffold.root_invariance import aims
from neuroanimator.state.layout import Bounds

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


def controls_without_range(model: mujoco.MjModel) -> list[int]:
    """Return the controls without a range in the model."""
    return [i for i in range(model.nu) if control_range(model, i) is None]


def proposed_bounds(model: mujoco.MjModel) -> dict[str, tuple[float, float]]:
    """Return the least and the largest value of each control: the model's own, else a guess."""
    bounds = {}
    for control, name in enumerate(control_names(model)):
        bound = control_range(model, control)
        if bound is None or not bound[0] < bound[1]:
            bound = _guessed(model, control)
        bounds[name] = bound
    return bounds


def possible_controls(
    model: mujoco.MjModel, bounds: Bounds
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"]]:
    """Return the smallest and the largest controls that might hold the model: `bounds`, or ±`ANY` where it gives no range."""
    low = np.array(bounds.low)
    high = np.array(bounds.high)
    unlimited = controls_without_range(model)
    low[unlimited] = np.minimum(low[unlimited], -ANY)
    high[unlimited] = np.maximum(high[unlimited], ANY)
    return low, high


def widen_guesses(
    model: mujoco.MjModel, bounds: dict[str, tuple[float, float]], held: Float[np.ndarray, " C"]
) -> None:
    """Widen guessed bounds so that half of them covers the controls `held` that hold the model."""
    names = control_names(model)
    for control in controls_without_range(model):
        if not aims(model, control):
            low, high = bounds[names[control]]
            needed = rounded(2 * abs(float(held[control])), 2)
            bounds[names[control]] = (min(low, -needed), max(high, needed))


def _guessed(model: mujoco.MjModel, control: int) -> tuple[float, float]:
    """Return a range for a control without one: that of its joint for a servo, of its forces for a motor."""
    actuator = actuators_of_controls(model)[control]
    joint = -1
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        joint = int(model.actuator_trnid[actuator][0])
    if aims(model, control) and joint >= 0:
        if model.jnt_limited[joint]:
            return tuple(model.jnt_range[joint].tolist())
        is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        return HALF_TURN if is_hinge else GUESS
    gain = abs(float(model.actuator_gainprm[actuator][0]))
    if model.actuator_forcelimited[actuator] and gain > 0:
        return tuple((model.actuator_forcerange[actuator] / gain).tolist())
    gain *= abs(float(model.actuator_gear[model.actuator_outadr[actuator]][0]))
    if joint >= 0 and model.jnt_actfrclimited[joint] and gain > 0:
        return tuple((model.jnt_actfrcrange[joint] / gain).tolist())
    return GUESS
