"""The OpenGL library that draws here without a screen. Does not import MuJoCo, which fails if MUJOCO_GL names a missing one."""

from __future__ import annotations

import os
import subprocess
from contextlib import suppress
from functools import cache

from neuroanimator.errors import ResourceError
from neuroanimator.executor.python_command import python_command
from neuroanimator.text import printable

BACKENDS = ("egl", "osmesa")
"""Graphics libraries that draw without a screen, tried in this order."""

HOW_TO_GET_GL = (
    "No OpenGL to draw with, so no video: install EGL or OSMesa (Debian: apt-get install libegl1 libosmesa6) "
    "and run again. Everything else works without."
)
"""Error message where nothing can be drawn."""

NOT_WITH_THIS_GL = (
    "MUJOCO_GL={asked} asks to draw with {asked} alone, which does not work here{why}. "
    "Unset it, or set it to egl or osmesa."
)
"""Error message where the requested graphics library cannot draw."""

TRIAL = """
import mujoco
context = mujoco.GLContext(16, 16)
context.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100)
print(type(context).__module__)
"""
"""Program that prints the module of the contexts it can draw with; without a display, GLFW's contexts draw nothing."""

MAX_TRIAL = 60
"""Time after which a trial is given up [s]."""


def needed_graphics() -> str:
    """Return the graphics library that can draw here; ResourceError says what is missing."""
    backend = graphics_backend()
    if backend is not None:
        return backend
    asked = os.environ.get("MUJOCO_GL")
    if not asked:
        raise ResourceError(HOW_TO_GET_GL)
    why = ": it needs a display" if asked == "glfw" else ""
    raise ResourceError(NOT_WITH_THIS_GL.format(asked=printable(asked), why=why))


def graphics_backend() -> str | None:
    """Return the graphics library that can draw here: the user's choice, or EGL or OSMesa; None if none can."""
    asked = os.environ.get("MUJOCO_GL")
    for backend in (asked,) if asked else BACKENDS:
        with suppress(ResourceError):
            context_module(backend)
            return backend
    return None


@cache
def context_module(backend: str) -> str:
    """Return MuJoCo's module of a graphics library; ResourceError if it cannot draw here.

    It is tried in a process of its own: a library that has failed cannot be unloaded.
    """
    environment = {**os.environ, "MUJOCO_GL": backend}
    command = python_command("-c", TRIAL)
    trial = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=MAX_TRIAL
    )
    if trial.returncode:
        raise ResourceError(f"{backend} cannot render here.")
    return trial.stdout.strip()
