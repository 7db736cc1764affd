"""A user's model, compiled and tried in a process with limits that can open no file."""

from __future__ import annotations

import re
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np
from numpy.random import (  # by name: the process that tries a model cannot open files later
    Generator,
    default_rng,
)

from neuroanimator.errors import ArgumentError, BadFileError, NeuroAnimatorError
from neuroanimator.executor.limited import LimitError, ProcessLimits, call_limited
from neuroanimator.files.numbers import MIN_STEP
from neuroanimator.physics.rigid.urdf import add_what_moves
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.systems.model_files import ModelFiles
from neuroanimator.systems.model_xml import NODE_LIMIT, Documents, refuse

MAX_MESSAGE = 300
"""Maximum number of characters of MuJoCo's message shown in an error."""

COMPILING = ProcessLimits(memory=2 * 2**30, seconds=60)
"""Limits of the process that compiles a model."""

OUT_OF_MEMORY = ("Could not allocate memory", "unknown exception")
"""Parts of MuJoCo's messages when it is out of memory."""

COMPILED = "compiled.mjb"
"""Name under which MuJoCo finds a compiled model in memory."""

COMPILED_KEPT = 4
"""Number of compiled models kept, as a user's model is loaded more than once."""

ADVICE = {
    "no decoder found": "MuJoCo reads STL, OBJ and MSH: convert the mesh, or put a primitive shape in its place",
    "ASCII": "Save the mesh as a binary STL",
    "balanceinertia": 'Correct the inertia, or add <compiler balanceinertia="true"/> (in a URDF inside of <mujoco>)',
    "positive eigenvalues": "Correct the inertia: no body has a negative one",
    "mjMINVAL": 'Give the body a mass, or add <compiler boundmass="1e-4" boundinertia="1e-7"/> (in a URDF inside of <mujoco>)',
    "mujocoinclude": "It is a part of other models: name one that includes it",
}
"""Advice on some of MuJoCo's refusals, by a part of its message."""

STARTS = 8
"""Number of states from which a model is tried: its reference pose, then random ones."""

STEPS = 50
"""Number of physics steps from each state."""

HOLD = 10
"""Number of steps for which each random control is held."""

LONGEST = 1.0
"""Processor time after which a trial ends [s]: one step of some models takes a tenth of a second."""

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


class ModelRequest(NamedTuple):
    """A model to compile."""

    name: str
    """Name of the model's main file in errors."""
    documents: Documents
    base: Literal["fixed", "free"] = "fixed"
    """Whether a URDF's root is fixed or free."""
    passive: tuple[str, ...] = ()
    """Joints of a URDF without a motor."""


def compile_model(
    files: ModelFiles,
    base: Literal["fixed", "free"] = "fixed",
    passive: tuple[str, ...] = (),
) -> mujoco.MjModel:
    """Return the compiled model, with MuJoCo's silent resets of NaN states off.

    It was compiled, and tried for a moment, in a process of its own, which a crash or a lack of memory ends instead of
    this one, and which has the model's files in memory and can open no other. MuJoCo's working memory has the maximum
    size: untouched memory costs nothing. A URDF gets motors, except on `passive` joints, and a root that is fixed or
    free by `base`; see `urdf`. Raises BadFileError naming the file and the fault: all that `read_model_files` or MuJoCo
    refuses, no joints, a time step outside (0, 0.1] s, an infinite number or NaN in the compiled model, more bodies,
    degrees of freedom, memory or time than supported, or a model that MuJoCo cannot simulate.
    """
    content = _compiled(files, base, passive)
    return mujoco.MjModel.from_binary_path(COMPILED, {COMPILED: content})


@lru_cache(COMPILED_KEPT)
def _compiled(files: ModelFiles, base: Literal["fixed", "free"], passive: tuple[str, ...]) -> bytes:
    """Return the compiled model in MuJoCo's format, made within limits."""
    request = ModelRequest(files.main, files.documents(), base, passive)
    try:
        return call_limited(compile_here, request, COMPILING)
    except LimitError as error:
        raise BadFileError(
            f"{files.main}: compiling it {error}. Use fewer or simpler meshes, and smaller pictures."
        ) from error


def compile_here(request: ModelRequest) -> bytes:
    """Return the compiled model in MuJoCo's format, made in this process."""
    with _faults_named(request.name), quiet():
        model = spec_of(request).compile()
    check_model(request.name, model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    try:
        with warnings_counted:
            try_model(model)
    except BadFileError as error:
        raise BadFileError(f"{request.name}: {error}") from error
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


@contextmanager
def _faults_named(main: str) -> Iterator[None]:
    """Turn MuJoCo's errors into a BadFileError about the file `main`."""
    try:
        yield
    except NeuroAnimatorError:
        raise
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        # MuJoCo's line numbers refer to the text it was given, so they would mislead.
        line = " ".join(str(error).split())
        message = re.sub(r",? ?\(?line =? ?\d+\)?", "", line)[:MAX_MESSAGE]
        if any(part in message for part in OUT_OF_MEMORY):
            raise MemoryError from error
        advice = "Correct the model"
        for part, better in ADVICE.items():
            if part in message:
                advice = better
        raise BadFileError(f"{main}: {message.rstrip('. ')}. {advice}.") from error


def spec_of(request: ModelRequest) -> mujoco.MjSpec:
    """Return what MuJoCo reads of a request, with what it does not read of a URDF."""
    documents = request.documents
    # The mesh of a flexcomp is read with the XML, all others when the model is compiled.
    spec = mujoco.MjSpec.from_string(
        documents.main,
        include=documents.includes | documents.assets,
        assets=documents.assets,
    )
    spec.memory = MEMORY_LIMIT
    # Threads, or the cache, would wait for ever for the lock of a thread without memory.
    spec.compiler.usethread = False
    mujoco.mj_setCacheCapacity(mujoco.mj_getCache(), 0)
    if documents.is_urdf:
        robot = ET.fromstring(documents.main)
        add_what_moves(spec, request.name, robot, request.base, request.passive)
    elif request.passive:
        raise ArgumentError(
            "passive: joints of a URDF may be passive. In an MJCF model take their actuators out."
        )
    return spec


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's warnings off the console and out of a MUJOCO_LOG.TXT in the current folder."""
    before = mujoco.MjLogConfig.get()
    quiet = mujoco.MjLogConfig.get()
    quiet.logto_file = False
    quiet.logto_console = False
    mujoco.MjLogConfig.set(quiet)
    try:
        yield
    finally:
        mujoco.MjLogConfig.set(before)


def try_model(model: mujoco.MjModel) -> None:
    """Simulate a model from its reference pose and from random states, by random controls; raises mujoco.FatalError."""
    rng = default_rng(0)
    data = mujoco.MjData(model)
    until = time.process_time() + LONGEST
    starts = STARTS
    if model.nflex:
        starts = 1  # a soft body with scattered nodes is none
    for start in range(starts):
        mujoco.mj_resetData(model, data)
        if start:
            # In the space of velocities, so that orientations stay unit quaternions.
            mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
            data.qvel[:] = rng.normal(size=model.nv)
        for step in range(STEPS):
            if step % HOLD == 0:
                data.ctrl[:] = _random_controls(model, rng)
            mujoco.mj_step(model, data)
            if time.process_time() > until:
                return


def _random_controls(model: mujoco.MjModel, rng: Generator) -> np.ndarray:
    """Return random controls in their ranges, or about 0 without a range."""
    low, high = model.actuator_ctrlrange.T
    is_limited = model.actuator_ctrllimited.astype(bool)
    return np.where(is_limited, rng.uniform(low, high), rng.normal(size=model.nu))


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
