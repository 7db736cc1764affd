"""The mass-spring loop in C as one writes it down, for any body: another opponent of the emulators of deformable bodies.

It reads the body from tables, as MuJoCo reads its model. The package's own C (physics/deformable/native) is made for
one body and about twice as fast: that is what `evaluate` measures against.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.compiler import compiled_library
from neuroanimator.physics.deformable.body import GRAVITY, Body

PROGRAM = Path(__file__).with_name("plain_mass_spring.c")
"""The C program, the same for all bodies."""

INTEGERS = ctypes.POINTER(ctypes.c_int)
FLOATS = ctypes.POINTER(ctypes.c_float)

NO_SLIP = 1.0
"""Sliding speed given where there is no ground [m/s]: nothing is divided by zero."""


class _Body(ctypes.Structure):
    """The program's `Body`, field by field."""

    _fields_ = (
        ("points", ctypes.c_int),
        ("springs", ctypes.c_int),
        ("faces", ctypes.c_int),
        ("muscles", ctypes.c_int),
        ("external_forces", ctypes.c_int),
        ("ends", INTEGERS),
        ("stiffness", FLOATS),
        ("damping", FLOATS),
        ("length", FLOATS),
        ("muscle", INTEGERS),
        ("shorten", FLOATS),
        ("mass", FLOATS),
        ("inverse", FLOATS),
        ("lift", FLOATS),
        ("corners", INTEGERS),
        ("share", FLOATS),
        ("acceleration", FLOATS),
        ("face_drag", ctypes.c_float),
        ("drag", ctypes.c_float),
        ("surface", ctypes.c_float),
        ("depth", ctypes.c_float),
        ("gravity", ctypes.c_float),
        ("ground_stiffness", ctypes.c_float),
        ("ground_damping", ctypes.c_float),
        ("friction", ctypes.c_float),
        ("slip", ctypes.c_float),
    )


def plain_player(
    body: Body,
    starts: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B C"],
    dt: float,
    steps: int,
) -> Callable[[], Float[np.ndarray, "B S"]] | None:
    """Return a function that takes `steps` symplectic steps of `dt` [s] from `starts` under held `controls`.

    It returns the states in float32. None where no C compiler is found, or where several muscles pull at
    one spring, which this program does not know.
    """
    library = compiled_library(PROGRAM.read_text(encoding="utf-8"))
    muscles_per_spring = np.count_nonzero(body.muscles, axis=1)
    if library is None or (muscles_per_spring > 1).any():
        return None
    remaining = 0.0
    if body.time_constant:
        remaining = float(np.exp(-dt / body.time_constant))
    tables = _tables(body)
    described = _described(body, tables)
    held = np.ascontiguousarray(controls, np.float32)

    def play() -> np.ndarray:
        states = np.array(starts, np.float32, order="C")
        library.plain(
            ctypes.byref(described),
            len(states),
            steps,
            ctypes.c_float(dt),
            ctypes.c_float(remaining),
            states.ctypes.data_as(FLOATS),
            held.ctypes.data_as(FLOATS),
        )
        assert tables  # kept alive: `described` points into them
        return states

    return play


def _tables(body: Body) -> dict[str, np.ndarray]:
    """Return the arrays the program reads, by the names of the fields that point to them."""
    muscle = np.full(len(body.springs), -1)
    if body.muscles.shape[1]:
        has_muscle = body.muscles.any(axis=1)
        muscle = np.where(has_muscle, body.muscles.argmax(axis=1), -1)
    share = np.take_along_axis(body.face_shares, body.faces, axis=1)
    is_fourth_own = body.faces[:, 3] != body.faces[:, 0]
    share[:, 3] *= is_fourth_own
    tables = {
        "ends": body.springs,
        "stiffness": body.stiffness,
        "damping": body.damping,
        "length": body.lengths,
        "muscle": muscle,
        "shorten": body.muscles.sum(axis=1),
        "mass": body.masses,
        "inverse": 1 / body.masses,
        "lift": body.lift,
        "corners": body.faces,
        "share": share,
        "acceleration": body.external_forces / body.masses.sum(),
    }
    return {name: _as_c_reads_it(table) for name, table in tables.items()}


def _as_c_reads_it(table: np.ndarray) -> np.ndarray:
    number_type = np.int32 if table.dtype.kind == "i" else np.float32
    return np.ascontiguousarray(table, number_type)


def _described(body: Body, tables: dict[str, np.ndarray]) -> _Body:
    """Return the body as C's structure, which points into `tables`."""
    muscles = body.muscles.shape[1]
    described = _Body(
        points=len(body.masses),
        springs=len(body.springs),
        muscles=muscles,
        external_forces=0 if muscles else body.external_forces.shape[1],
        gravity=GRAVITY * body.has_gravity,
        slip=NO_SLIP,
    )
    for name, table in tables.items():
        pointer = INTEGERS if table.dtype == np.int32 else FLOATS
        setattr(described, name, table.ctypes.data_as(pointer))
    if body.water is not None:
        described.faces = len(body.faces)
        described.face_drag = body.water.face_drag
        described.drag = body.water.drag
        if body.water.surface is not None:
            described.surface = body.water.surface
            described.depth = body.water.depth
    if body.ground is not None:
        described.ground_stiffness = body.ground.stiffness
        described.ground_damping = body.ground.damping
        described.friction = body.ground.friction
        described.slip = body.ground.slip
    return described
