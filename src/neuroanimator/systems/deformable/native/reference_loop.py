"""The mass-spring loop in C as one writes it down, for any body: what nominal speed-ups are measured against.

The physics of rigid bodies is MuJoCo's, which reads its model from tables; so does this. `c_twin.py` makes the
fastest program for one body, which is what an emulator of equal error has to beat.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path

import numpy as np

from neuroanimator.compiler.compiler import compiled_library
from neuroanimator.systems.deformable.body import GRAVITY, Body

PROGRAM = Path(__file__).with_name("mass_spring_plain.c")

INTEGERS = ctypes.POINTER(ctypes.c_int)
FLOATS = ctypes.POINTER(ctypes.c_float)


class _Body(ctypes.Structure):
    _fields_ = (
        [
            (name, ctypes.c_int)
            for name in ("points", "springs", "faces", "muscles", "external_forces")
        ]
        + [
            ("ends", INTEGERS),
            ("stiffness", FLOATS),
            ("damping", FLOATS),
            ("length", FLOATS),
            ("muscle", INTEGERS),
        ]
        + [
            ("shorten", FLOATS),
            ("mass", FLOATS),
            ("inverse", FLOATS),
            ("lift", FLOATS),
            ("corners", INTEGERS),
            ("share", FLOATS),
            ("push", FLOATS),
        ]
        + [(name, ctypes.c_float) for name in ("mu", "drag", "surface", "depth", "gravity")]
        + [(name, ctypes.c_float) for name in ("hard", "soft", "friction", "slip")]
    )


def plain_player(
    body: Body, starts: np.ndarray, controls: np.ndarray, dt: float, steps: int
) -> Callable[[], np.ndarray] | None:
    """Return a function that takes `steps` symplectic steps of `dt` [s] from starts (B, S) under controls (B, C).

    It returns the states (B, S) in float32. None where no C compiler is found, or where several muscles pull at
    one spring, which this program does not know.
    """
    library = compiled_library(PROGRAM.read_text(encoding="utf-8"))
    if library is None or (np.count_nonzero(body.muscles, axis=1) > 1).any():
        return None
    kept = float(np.exp(-dt / body.time_constant)) if body.time_constant else 0.0
    described, tables = _described(body)
    held = np.ascontiguousarray(controls, np.float32)

    def play() -> np.ndarray:
        states = np.array(starts, np.float32, order="C")
        library.plain(
            ctypes.byref(described), len(states), steps, ctypes.c_float(dt), ctypes.c_float(kept),
            states.ctypes.data_as(FLOATS), held.ctypes.data_as(FLOATS),
        )  # fmt: skip
        assert tables  # kept alive: `described` points into them
        return states

    return play


def _described(body: Body) -> tuple[_Body, list[np.ndarray]]:
    """Return the body as C's structure, and the arrays it points into."""
    water, ground, muscles = body.water, body.ground, body.muscles.shape[1]
    owner = np.where(body.muscles.any(axis=1), body.muscles.argmax(axis=1) if muscles else 0, -1)
    share = np.take_along_axis(body.face_shares, body.faces, axis=1)
    share[:, 3] *= body.faces[:, 3] != body.faces[:, 0]
    external_forces = 0 if muscles else body.external_forces.shape[1]
    numbers = [
        body.springs,
        body.stiffness,
        body.damping,
        body.lengths,
        owner,
        body.muscles.sum(axis=1),
    ]
    numbers += [
        body.masses,
        1 / body.masses,
        body.lift,
        body.faces,
        share,
        body.external_forces / body.masses.sum(),
    ]
    tables = [
        np.ascontiguousarray(each, np.int32 if each.dtype.kind == "i" else np.float32)
        for each in numbers
    ]
    pointers = [t.ctypes.data_as(INTEGERS if t.dtype.kind == "i" else FLOATS) for t in tables]
    surface = water.surface if water else None
    around = [water.face_drag, water.drag] if water else [0.0, 0.0]
    around += [
        surface or 0.0,
        water.depth if water and surface is not None else 0.0,
        GRAVITY * body.has_gravity,
    ]
    below = (
        [ground.stiffness, ground.damping, ground.friction, ground.slip]
        if ground
        else [0.0, 0.0, 0.0, 1.0]
    )
    sizes = (
        len(body.masses),
        len(body.springs),
        len(body.faces) if water else 0,
        muscles,
        external_forces,
    )
    return _Body(*sizes, *pointers, *around, *below), tables
