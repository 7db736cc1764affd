"""Controls that hold a model in its pose of rest: hover thrust, the servo angles of a stance, what carries an arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from neuroanimator.scaffold.defaults import tidy
from neuroanimator.systems.rigid.warnings import warnings_counted

HOLD_SECONDS = 0.3
"""Controls are judged by how fast the model has become after this time [s]: a fall shows, a stance has settled."""

BETTER = 0.5
"""Controls count as holding a model if it then moves less than this share of what it does uncontrolled."""

NEGLIGIBLE = 0.01
"""Less than this share of a control's range is taken for no control at all."""

DIGITS = 5
"""Number of digits of the controls that hold a model."""

PROBE = 1e-3
"""Accelerations are differentiated with controls this far apart, as a share of their range."""


class Hold(NamedTuple):
    """Controls that hold a model at rest, and where they come from."""

    controls: Float[np.ndarray, " C"]
    source: str
    """Words for a comment; empty if nothing holds it better than no control at all."""


def holding_controls(
    model: mujoco.MjModel,
    rest: Float[np.ndarray, " P"],
    low: Float[np.ndarray, " C"],
    high: Float[np.ndarray, " C"],
    keyframe: int,
) -> Hold:
    """Return the controls between `low` and `high` that keep `model` stillest at `rest` (qpos, qvel, act).

    The keyframe's own (`keyframe` is its number, or -1), those of inverse dynamics, and those that only keep the driven
    joints from moving are tried for a moment; no control at all unless one of them is clearly better.
    """
    idle = np.clip(np.zeros(model.nu), low, high)
    with warnings_counted:
        held, driven = _inverse_dynamics(model, rest, low, high)
        candidates = [
            Hold(held, "holds it, by inverse dynamics"),
            Hold(driven, "keeps its joints from moving, by inverse dynamics"),
        ]
        if keyframe >= 0:
            given = np.clip(model.key_ctrl[keyframe], low, high)
            candidates.insert(0, Hold(given, "the keyframe's own"))
        best = Hold(idle, "")
        least = BETTER * _motion_after(model, rest, idle)
        for candidate in candidates:
            motion = _motion_after(model, rest, candidate.controls)
            if motion < least:
                best = candidate
                least = motion
    return best


def holding_table(
    model: mujoco.MjModel, bounds: Mapping[str, tuple[float, float]], hold: Hold
) -> dict[str, float]:
    """Return by an actuator's name the control that holds the model, within `bounds`; empty if it is none at all."""
    if not hold.source:
        return {}
    table = {}
    is_worth_saying = False
    for actuator, (name, (low, high)) in enumerate(bounds.items()):
        held = float(np.clip(tidy(hold.controls[actuator], DIGITS), low, high))
        table[name] = held
        is_worth_saying |= abs(held) > NEGLIGIBLE * (high - low)
    return table if is_worth_saying else {}


def at(
    model: mujoco.MjModel, rest: Float[np.ndarray, " P"], controls: Float[np.ndarray, " C"]
) -> mujoco.MjData:
    """Return the model's data at `rest` under `controls`, activations having followed these."""
    data = mujoco.MjData(model)
    data.qpos[:] = rest[: model.nq]
    data.ctrl[:] = controls
    for actuator in range(model.nu):
        first = model.actuator_actadr[actuator]
        follows = model.actuator_dyntype[actuator] != mujoco.mjtDyn.mjDYN_INTEGRATOR
        if first >= 0 and follows:
            count = model.actuator_actnum[actuator]
            data.act[first : first + count] = controls[actuator]
    mujoco.mj_forward(model, data)
    return data


def _inverse_dynamics(
    model: mujoco.MjModel,
    rest: Float[np.ndarray, " P"],
    low: Float[np.ndarray, " C"],
    high: Float[np.ndarray, " C"],
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"]]:
    """Return the controls with least acceleration of all joints, and with least acceleration of those they drive.

    Accelerations are those without contacts and limits, which are linear in the controls of almost every actuator.
    """
    middle = (low + high) / 2
    reach = PROBE * (high - low)
    base = at(model, rest, middle).qacc_smooth.copy()
    columns = []
    for actuator in range(model.nu):
        controls = middle.copy()
        controls[actuator] += reach[actuator]
        change = at(model, rest, controls).qacc_smooth - base
        columns.append(change / reach[actuator])
    slopes = np.stack(columns, axis=1)
    # Roots that nothing drives directly are left to fall; a motor's own joint is where it acts most.
    driven = np.unique(np.abs(slopes).argmax(axis=0))
    solutions = []
    for rows in (np.arange(model.nv), driven):
        wanted = slopes[rows] @ middle - base[rows]
        solution = lsq_linear(slopes[rows], wanted, bounds=(low, high))
        solutions.append(np.asarray(solution.x))
    return solutions[0], solutions[1]


def _motion_after(
    model: mujoco.MjModel, rest: Float[np.ndarray, " P"], controls: Float[np.ndarray, " C"]
) -> float:
    """Return the rms of all velocities a moment after `rest` under `controls`; infinite if it diverges."""
    data = at(model, rest, controls)
    steps = max(1, round(HOLD_SECONDS / model.opt.timestep))
    mujoco.mj_step(model, data, steps)
    speed = float(np.sqrt(np.mean(data.qvel**2)))
    return speed if np.isfinite(speed) else float("inf")
