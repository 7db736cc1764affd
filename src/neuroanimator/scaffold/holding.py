"""Controls that hold a model in its pose of rest, its stance under them, and the growth rate of a fall."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import lsq_linear

from neuroanimator.physics.rigid.actuators import actuators_of_controls
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.scaffold.actuators import possible_controls
from neuroanimator.scaffold.defaults import rounded
from neuroanimator.scaffold.root_invariance import gravity_of, has_contacts

HOLD_SECONDS = 0.3
"""Time after which controls are judged by the model's speed [s]: a fall shows, a stance has settled."""

BETTER = 0.5
"""Share of the uncontrolled model's motion below which controls count as holding it."""

NEGLIGIBLE = 0.01
"""Share of a control's range that counts as no control."""

DIGITS = 5
"""Number of digits of holding controls."""

PROBE = 1e-3
"""Finite difference of controls in derivatives of accelerations, as a share of their range."""

MAX_LEAN = 1.0
"""Largest angle between a root's up axis and its direction at rest at which the root counts as upright [rad]."""

STAND_SECONDS = 2.0
"""Time after which a root that its controls hold is still upright [s]."""

NUDGE = 1e-6
"""Size of the finite differences that linearise the model at rest."""

FOLLOWING = tuple(
    int(kind)
    for kind in (
        mujoco.mjtDyn.mjDYN_FILTER,
        mujoco.mjtDyn.mjDYN_FILTEREXACT,
        mujoco.mjtDyn.mjDYN_MUSCLE,
        mujoco.mjtDyn.mjDYN_USER,
    )
)
"""Kinds of actuators whose activation settles at the control, as integers."""

Controls = Float[np.ndarray, " C"]
"""Controls of all actuators."""


class Hold(NamedTuple):
    """Controls that hold a model at rest, and their source."""

    controls: Controls
    source: str
    """Source in words, for a comment; empty if nothing holds it better than no control."""


class Stance(NamedTuple):
    """The stance at rest of a root that may fall."""

    up: Float[np.ndarray, " 3"]
    """The root's axis that points up at rest."""
    lies: bool
    """Whether the root itself is on the ground at rest."""
    hovers: bool
    """Whether its controls hold it in the air."""
    is_held: bool
    """Whether it stays upright under the holding controls: if not, gentler ones do not help."""


def holding_controls(system: ModelSystem, keyframe: int) -> Hold:
    """Return the controls that keep the model stillest at rest.

    The keyframe's own (`keyframe` is its number, or -1) and those of inverse dynamics are tried for a moment; no control
    is used unless one of them is clearly better.
    """
    model = system.model
    low, high = possible_controls(model, system.bounds)
    best = Hold(np.clip(np.zeros(model.nu), low, high), "")
    with warnings_counted:
        candidates = [Hold(_inverse_dynamics(system, low, high), "holds it")]
        if keyframe >= 0:
            given = np.clip(model.key_ctrl[keyframe], low, high)
            candidates.insert(0, Hold(given, "the keyframe's own"))
        least = BETTER * _motion_after(system, best.controls)
        for candidate in candidates:
            motion = _motion_after(system, candidate.controls)
            if motion < least:
                best = candidate
                least = motion
    return best


def _inverse_dynamics(system: ModelSystem, low: Controls, high: Controls) -> Controls:
    """Return the controls with least acceleration of all joints, without contacts and limits.

    Such accelerations are linear in the controls of almost every actuator.
    """
    model = system.model
    middle = (low + high) / 2
    reach = PROBE * (high - low)
    base = at(model, system.rest, middle).qacc_smooth.copy()
    slopes = np.zeros((model.nv, model.nu))
    for control in range(model.nu):
        controls = middle.copy()
        controls[control] += reach[control]
        change = at(model, system.rest, controls).qacc_smooth - base
        slopes[:, control] = change / reach[control]
    solution = lsq_linear(slopes, slopes @ middle - base, bounds=(low, high))
    return np.asarray(solution.x)


def holding_table(bounds: Mapping[str, tuple[float, float]], hold: Hold) -> dict[str, float]:
    """Return the control that holds the model by name, within `bounds`; empty for no control."""
    table = {}
    is_worth_saying = False
    for (name, (low, high)), control in zip(bounds.items(), hold.controls, strict=True):
        table[name] = float(np.clip(rounded(control, DIGITS), low, high))
        is_worth_saying |= abs(table[name]) > NEGLIGIBLE * (high - low)
    return table if is_worth_saying and hold.source else {}


def at(model: mujoco.MjModel, rest: Float[np.ndarray, " P"], controls: Controls) -> mujoco.MjData:
    """Return the model's data at `rest` under `controls`, with settled activations."""
    data = mujoco.MjData(model)
    data.qpos[:] = rest[: model.nq]
    data.ctrl[:] = controls
    for control, actuator in enumerate(actuators_of_controls(model)):
        if int(model.actuator_dyntype[actuator]) in FOLLOWING:
            first = model.actuator_actadr[actuator]
            data.act[first : first + model.actuator_actnum[actuator]] = controls[control]
    mujoco.mj_forward(model, data)
    return data


def _motion_after(system: ModelSystem, controls: Controls) -> float:
    """Return the rms of all velocities a moment after rest under `controls`; infinite if it diverges."""
    data = at(system.model, system.rest, controls)
    _advance(system.model, data, HOLD_SECONDS)
    speed = float(np.sqrt(np.mean(data.qvel**2)))
    return speed if np.isfinite(speed) else float("inf")


def _advance(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    """Step the model for some `seconds`, and find the positions of its bodies then."""
    mujoco.mj_step(model, data, max(1, round(seconds / model.opt.timestep)))
    mujoco.mj_fwdPosition(model, data)


def growth_at_rest(system: ModelSystem, controls: Controls) -> float:
    """Return the rate at which the fastest fall from rest under `controls` grows [1/s]; 0 if none does.

    It is the largest real part of the linearised model's eigenvalues; 0 for a model that can touch something, as a contact
    at rest would look like a force that throws it off.
    """
    model = system.model.__copy__()
    if has_contacts(model):
        return 0.0
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    size = 2 * model.nv + model.na
    transition = np.zeros((size, size))
    with warnings_counted:
        data = at(model, system.rest, controls)
        if data.nefc:
            return 0.0
        mujoco.mjd_transitionFD(model, data, NUDGE, True, transition, None, None, None)
    if not np.isfinite(transition).all():
        return 0.0
    largest = float(np.abs(np.linalg.eigvals(transition)).max())
    return float(np.log(max(largest, 1.0))) / model.opt.timestep


def stance_of(system: ModelSystem, hold: Hold) -> Stance | None:
    """Return the root's stance at rest, a moment after `hold` sets in; None for one that cannot fall."""
    model = system.model
    if not system.sampling.above_ground or not gravity_of(model).any():
        return None
    with warnings_counted:
        data = at(model, system.rest, hold.controls)
        up = data.xmat[_root(model)].reshape(3, 3)[2].copy()
        _advance(model, data, HOLD_SECONDS)
        touching = _bodies_on_ground(model, data)
        lies = _root(model) in touching
        hovers = bool(hold.source) and not touching.size
        _advance(model, data, STAND_SECONDS - HOLD_SECONDS)
        stance = Stance(up, lies, hovers, is_held=True)
        return stance._replace(is_held=_is_upright(model, data, stance))


def are_upright(
    system: ModelSystem, stance: Stance | None, states: Float[np.ndarray, "*B S"]
) -> Bool[np.ndarray, "*B"]:
    """Return whether the root leans by less than `MAX_LEAN`, and does not lie unless it does so at rest, in each state.

    A root that cannot fall is always upright.
    """
    upright = np.ones(states.shape[:-1], bool)
    if stance is None:
        return upright
    data = mujoco.MjData(system.model)
    with warnings_counted:
        for row in np.ndindex(upright.shape):
            system.put(data, states[row])
            mujoco.mj_fwdPosition(system.model, data)
            upright[row] = _is_upright(system.model, data, stance)
    return upright


def _is_upright(model: mujoco.MjModel, data: mujoco.MjData, stance: Stance) -> bool:
    root = _root(model)
    height = data.xmat[root].reshape(3, 3)[2] @ stance.up
    lies_down = not stance.lies and root in _bodies_on_ground(model, data)
    return bool(height > np.cos(MAX_LEAN)) and not lies_down


def _root(model: mujoco.MjModel) -> int:
    """Return the root body of the first joint's tree."""
    return int(model.body_rootid[model.jnt_bodyid[0]])


def _bodies_on_ground(model: mujoco.MjModel, data: mujoco.MjData) -> Int[np.ndarray, " N"]:
    """Return the bodies in contact with something fixed."""
    bodies = model.body_weldid[model.geom_bodyid[data.contact.geom]].reshape(-1, 2)
    return bodies[(bodies == 0).any(axis=1)].max(axis=1)
