"""Checks of a compiled model: its size, its numbers, and parts that are not supported."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from neuroanimator.files.numbers import MIN_STEP
from neuroanimator.systems.model_xml import NODE_LIMIT, refuse

BODY_LIMIT = 500
"""Maximum number of a model's bodies."""

FREEDOM_LIMIT = 200
"""Maximum number of a model's degrees of freedom."""

STEP_LIMIT = 0.1
"""Maximum time step of a model [s]."""

NUMBER_LIMIT = 10_000
"""Maximum number of a model's sensor readings, and of its activations."""

ITERATION_LIMIT = 1000
"""Maximum number of iterations of a model's solvers: a step may take them all."""

MEMORY_LIMIT = 256 * 2**20
"""Maximum size of a compiled model and of its state, and size of MuJoCo's working memory for it [bytes]."""

LARGEST = {
    "nodes": ("nflexvert", NODE_LIMIT, "Give the soft body fewer"),
    "bodies": ("nbody", BODY_LIMIT, "Join bodies that are fixed to each other"),
    "degrees of freedom": ("nv", FREEDOM_LIMIT, "Fix joints that need not move"),
    "model memory": ("nbuffer", MEMORY_LIMIT, "Use fewer or simpler meshes, and smaller pictures"),
    "sensor readings": ("nsensordata", NUMBER_LIMIT, "Write a smaller model"),
    "activations": ("na", NUMBER_LIMIT, "Write a smaller model"),
}
"""MuJoCo's name of each limited number, its limit, and advice on a model that has more.

Each node of a soft body may be a separate body, with three degrees of freedom.
"""


def check_model(main: str, model: mujoco.MjModel) -> None:
    """Refuse a compiled model that cannot move, is too large, or has an infinite number or NaN anywhere."""
    step = model.opt.timestep
    if not MIN_STEP <= step <= STEP_LIMIT:
        refuse(main, f"option timestep={step:g}", f"wanted {MIN_STEP:g} to {STEP_LIMIT} s")
    if model.njnt == 0:
        refuse(main, "worldbody", "no joints, so nothing can move. Add a joint")
    if model.nhistory:
        refuse(
            main,
            "delay",
            "the history of an actuator or a sensor is not part of the state. Remove nsample and delay",
        )
    of_nodes = {"nbody": model.nflexvert, "nv": 3 * model.nflexvert}
    for name, (field, limit, advice) in LARGEST.items():
        size = getattr(model, field)
        if size > limit + of_nodes.get(field, 0):
            refuse(main, f"{name} ({field}={size:,})", f"at most {limit:,} is supported. {advice}")
    for name in dir(model.opt):
        if name.endswith("iterations") and getattr(model.opt, name) > ITERATION_LIMIT:
            refuse(main, f"option {name}", f"at most {ITERATION_LIMIT:,} is supported")
    _check_finite(main, model)
    state_size = mujoco.MjData(model).nbuffer
    if state_size > MEMORY_LIMIT:
        refuse(
            main,
            f"size ({state_size:,} bytes of state)",
            f"at most {MEMORY_LIMIT:,} is supported. Write a smaller model",
        )


def _check_finite(main: str, model: mujoco.MjModel) -> None:
    for part in (model, model.opt, model.stat):
        for name in dir(part):
            if not _is_finite(getattr(part, name)):
                refuse(
                    main,
                    name,
                    "not finite. Write finite numbers, and leave out infinite ranges",
                )


def _is_finite(value: Any) -> bool:
    """Return False for a number or an array with an infinite number or NaN; True for anything else."""
    is_array = isinstance(value, np.ndarray) and value.dtype.kind == "f"
    if not is_array and not isinstance(value, float):
        return True
    return bool(np.isfinite(value).all())
