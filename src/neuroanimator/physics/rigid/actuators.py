"""The actuators of a MuJoCo model as a control vector: its names, units and bounds.

Most have one control and one force. A servo of an orientation has three or four controls and three forces, a PID servo
and a DC motor as many controls as inputs, and one without inputs none.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from jaxtyping import Float, Int

from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known, model_name, refuse_twins
from neuroanimator.state.layout import Bounds, Layout, Slice

INPUTS = {
    mujoco.mjtCtrlInput.mjINPUT_POS: "pos",
    mujoco.mjtCtrlInput.mjINPUT_VEL: "vel",
    mujoco.mjtCtrlInput.mjINPUT_FF: "ff",
    mujoco.mjtCtrlInput.mjINPUT_VOLTAGE: "voltage",
    mujoco.mjtCtrlInput.mjINPUT_PRESSURE: "pressure",
}
"""MuJoCo's names of the inputs of servos and motors, in the order of their controls."""

MUSCLE = (0.0, 1.0)
"""Range of a muscle's excitation, to which controls are clipped."""


def actuator_name(model: mujoco.MjModel, actuator: int) -> str:
    """Return the name of an actuator; `actuator_3` if it has none."""
    return model_name(model.actuator(actuator).name, f"actuator_{actuator}")


def actuators_of_controls(model: mujoco.MjModel) -> Int[np.ndarray, " C"]:
    """Return the actuator of each control."""
    return np.repeat(np.arange(model.nactuator), model.actuator_ctrlnum)


def input_of(model: mujoco.MjModel, control: int) -> str:
    """Return MuJoCo's name of the input that a control is, or its axis if it turns; empty for the only one of most actuators."""
    actuator = actuators_of_controls(model)[control]
    number = control - model.actuator_ctrladr[actuator]
    spec = int(model.actuator_ctrlspec[actuator])
    if model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_SO3:
        return "wxyz"[-model.actuator_ctrlnum[actuator] :][number]
    inputs = [name for bit, name in INPUTS.items() if spec & int(bit)]
    return inputs[number] if inputs else ""


def control_names(model: mujoco.MjModel) -> list[str]:
    """Return the name of each control: its actuator's, with that of its input where the actuator has several."""
    names = []
    for control, actuator in enumerate(actuators_of_controls(model).tolist()):
        name = actuator_name(model, actuator)
        if model.actuator_ctrlnum[actuator] > 1:
            name += f"_{input_of(model, control)}"
        names.append(name)
    return names


def layout_of_controls(model: mujoco.MjModel) -> Layout:
    """Return the controls in the model's order, one number each; ArgumentError if two have one name."""
    names = control_names(model)
    refuse_twins(names, "actuators")
    slices = [Slice(name, 1, control_unit(model, i)) for i, name in enumerate(names)]
    return Layout(tuple(slices))


def moment_arms(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "F V"]:
    """Return the moment arms of all actuators' forces about all degrees of freedom."""
    dense = np.zeros((model.nout, model.nv))
    mujoco.mju_sparse2dense(
        dense, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return dense


def bounds_of_controls(
    model: mujoco.MjModel,
    given: Mapping[str, tuple[float, float]],
    holding: Mapping[str, float],
) -> Bounds:
    """Return the bounds of all controls: those `given` by name, else the model's own; `holding` are holding controls by name.

    Raises ArgumentError for an unknown name, for bounds that are missing or empty, and for a holding control beyond them.
    """
    names = control_names(model)
    for table, keys in (("control", given), ("holding", holding)):
        check_known(keys, names, "actuator", table)
    low = []
    high = []
    for control, name in enumerate(names):
        bound = given.get(name) or control_range(model, control)
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


def control_range(model: mujoco.MjModel, control: int) -> tuple[float, float] | None:
    """Return the least and the largest value of a control in the model, or None without a range; a muscle's are `MUSCLE`."""
    if not model.actuator_ctrllimited[control]:
        actuator = actuators_of_controls(model)[control]
        is_muscle = model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_MUSCLE
        return MUSCLE if is_muscle else None
    low, high = model.actuator_ctrlrange[control].tolist()
    return low, high


def control_unit(model: mujoco.MjModel, control: int) -> str:
    """Return the unit of a control if it is certain, else 1."""
    actuator = actuators_of_controls(model)[control]
    if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT:
        return "1"
    joint = model.actuator_trnid[actuator][0]
    is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    position, force = ("rad", "N·m") if is_hinge else ("m", "N")
    is_motor = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    gain = model.actuator_gainprm[actuator][0]
    is_ungeared = model.actuator_gear[model.actuator_outadr[actuator]][0] == 1
    kind = input_of(model, control)
    if kind:
        of_inputs = {"pos": position, "vel": f"{position}/s", "ff": force} if is_ungeared else {}
        return of_inputs.get(kind, "1")
    if is_motor and gain == 1 and is_ungeared and not model.actuator_dyntype[actuator]:
        return force
    is_servo = not is_motor and gain == -model.actuator_biasprm[actuator][1]
    return position if is_servo and is_ungeared else "1"
