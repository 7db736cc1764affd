"""The actuators of a MuJoCo model as a control vector: its names, units and bounds."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import model_name
from neuroanimator.state.layout import Bounds, Layout, Slice

MUSCLE = (0.0, 1.0)
"""Range of a muscle's excitation, to which controls are clipped."""


def actuator_name(model: mujoco.MjModel, actuator: int) -> str:
    """Return the name of an actuator; `actuator_3` if it has none."""
    return model_name(model.actuator(actuator).name, f"actuator_{actuator}")


def layout_of_actuators(model: mujoco.MjModel) -> Layout:
    """Return the actuators in the model's order, one number each; ArgumentError if two have one name."""
    slices = [Slice(actuator_name(model, i), 1, control_unit(model, i)) for i in range(model.nu)]
    names = [part.name for part in slices]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(
                f"Two actuators would be called '{name}'. Rename one of them in the model."
            )
    return Layout(tuple(slices))


def moment_arms(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "U V"]:
    """Return the moment arms of all actuators about all degrees of freedom."""
    dense = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        dense, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return dense


def bounds_of_actuators(
    model: mujoco.MjModel,
    given: Mapping[str, tuple[float, float]],
    holding: Mapping[str, float],
) -> Bounds:
    """Return the bounds of all actuators: those `given` by name, else the model's own; `holding` are holding controls by name.

    Raises ArgumentError for an unknown name, for bounds that are missing or empty, and for a holding control beyond them.
    """
    names = [actuator_name(model, i) for i in range(model.nu)]
    for table, keys in (("control", given), ("holding", holding)):
        for name in keys:
            if name not in names:
                raise ArgumentError(
                    f"{table}: no actuator called '{name}'. Actuators: {', '.join(names)}."
                )
    low = []
    high = []
    for actuator, name in enumerate(names):
        bound = given.get(name) or control_range(model, actuator)
        if bound is None or not bound[0] < bound[1]:
            raise ArgumentError(
                f"control.{name}: wanted [least, largest], such as [-1, 1]; the model gives no range."
            )
        low.append(float(bound[0]))
        high.append(float(bound[1]))
        if not bound[0] <= holding.get(name, bound[0]) <= bound[1]:
            raise ArgumentError(
                f"holding.{name}: wanted {bound[0]:g} to {bound[1]:g}, as in control.{name}, got {holding[name]:g}."
            )
    held = tuple(float(holding.get(name, 0.0)) for name in names) if any(holding.values()) else ()
    return Bounds(tuple(low), tuple(high), held)


def control_range(model: mujoco.MjModel, actuator: int) -> tuple[float, float] | None:
    """Return the smallest and largest control in the model, or None without a range; a muscle's are `MUSCLE`."""
    if not model.actuator_ctrllimited[actuator]:
        is_muscle = model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_MUSCLE
        return MUSCLE if is_muscle else None
    low, high = model.actuator_ctrlrange[actuator]
    return float(low), float(high)


def control_unit(model: mujoco.MjModel, actuator: int) -> str:
    """Return the unit of a control if it is certain, else 1."""
    if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT:
        return "1"
    joint = model.actuator_trnid[actuator][0]
    is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    is_motor = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    gain = model.actuator_gainprm[actuator][0]
    is_ungeared = model.actuator_gear[actuator][0] == 1
    if is_motor and gain == 1 and is_ungeared and not model.actuator_dyntype[actuator]:
        return "N·m" if is_hinge else "N"
    is_servo = not is_motor and gain == -model.actuator_biasprm[actuator][1]
    if is_servo and is_ungeared:
        return "rad" if is_hinge else "m"
    return "1"
