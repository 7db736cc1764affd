"""The physics of soft bodies in C: loops over nodes and constraints, whose formulas are generated from JAX."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.c_formula import c_formula
from neuroanimator.codegen.compiler import compiled_library
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.physics.soft import constraints
from neuroanimator.physics.soft.soft_body import GRAVITY, Played, SoftBody
from neuroanimator.physics.water import Water, lift_of

PROGRAM = Path(__file__).with_name("soft.c")
"""Path of the loops, which are the same for every body."""

LANES = 16
"""Number of bodies simulated side by side: one AVX-512 register."""

MAX_AIR_SPEED = 60.0
"""Speed through air [m/s] beyond which its pressure stays the same, so that stray nodes are not flung about."""

MUSCLES_OF_A_SPRING = 2
"""Maximum number of muscles that shorten a spring: between two groups of tetrahedra, those of both."""

NO_SURFACE = 1e9
"""Height of the surface of water that is everywhere [m]."""

NUMBER = (1,)
VECTOR = (1, 3)
FORMULAS: dict[Callable[..., Any], tuple[tuple[int, ...], ...]] = {
    constraints.distance_push: (VECTOR, VECTOR, NUMBER, NUMBER, NUMBER, NUMBER),
    constraints.volume_slope: (VECTOR, VECTOR),
    constraints.volume_push: (VECTOR, VECTOR, NUMBER, NUMBER, NUMBER),
    constraints.fall: (VECTOR, VECTOR, VECTOR, NUMBER, NUMBER),
    constraints.air_push: (VECTOR, VECTOR, VECTOR, NUMBER, NUMBER),
    constraints.water_push: (*[VECTOR] * 3, *[NUMBER] * 4),
    constraints.lifted: (VECTOR, NUMBER, VECTOR, *[NUMBER] * 5),
    constraints.capsule_push: (*[VECTOR] * 6, NUMBER, NUMBER),
    constraints.box_push: (*[VECTOR] * 9, NUMBER, NUMBER),
    constraints.plane_push: (*[VECTOR] * 5, NUMBER, NUMBER),
}
"""Formulas, with the shapes of their arguments."""


class MuscleMotion(NamedTuple):
    """The muscles of a body in F - 1 frames; several bodies side by side are the last axis."""

    activations: Float[np.ndarray, "M ..."]
    """Activations at the start."""
    controls: Float[np.ndarray, "F-1 M ..."]
    """Controls in each frame, which activations approach."""


@dataclass(frozen=True, eq=False)
class SoftProgram:
    """A soft body's physics in C, `lanes` bodies at a time, in float32 or float64."""

    body: SoftBody
    lanes: int = 1
    dtype: type[np.floating] = np.float32

    def play(
        self,
        positions: Float[np.ndarray, "N 3 ..."],
        velocities: Float[np.ndarray, "N 3 ..."],
        movers: Float[np.ndarray, "F M 7 ..."],
        duration: float,
        steps: int,
        wind: Float[np.ndarray, "3 ..."] | None = None,
        muscles: MuscleMotion | None = None,
        surface: Float[np.ndarray, " ..."] | None = None,
    ) -> Played:
        """Return positions [m] and velocities [m/s] after each of F - 1 frames of `duration` [s] in `steps` small steps.

        `movers` are the movers' positions [m] and quaternions, at the start and at each frame's end; in between they
        move and turn evenly. `wind` is the velocity of the air [m/s], by default the body's own; muscles are idle by default, and
        `surface` is the height of the water's [m], by default infinite. Several lanes are the last axis of all arrays.
        """
        frames = len(movers) - 1
        tail = positions.shape[2:]
        if wind is None:
            own = np.reshape(self.body.air.wind, (3, *[1] * len(tail)))
            wind = np.broadcast_to(own, (3, *tail))
        surfaces = np.broadcast_to(NO_SURFACE if surface is None else surface, self.lanes)
        body, kept = _struct(self.body, movers.shape[1], wind, surfaces, self.dtype)
        count = len(self.body.positions)
        start = np.empty((2, 3, count, *tail), self.dtype)
        start[0] = np.moveaxis(positions, 0, 1)
        start[1] = np.moveaxis(velocities, 0, 1)
        paths = np.ascontiguousarray(movers, self.dtype)
        states = np.empty((frames, *start.shape), self.dtype)
        count = self.body.muscles.shape[1]
        if muscles is None:
            muscles = MuscleMotion(np.zeros((count, *tail)), np.zeros((frames, count, *tail)))
        controls = np.ascontiguousarray(muscles.controls, self.dtype)
        active = np.array(muscles.activations, self.dtype, order="C")
        used = (start, paths, controls, active, states)
        arrays = [array.ctypes.data_as(ctypes.c_void_p) for array in used]
        library = _library(self.lanes, self.dtype, count > 0)
        numbers = (ctypes.c_long(frames), ctypes.c_long(steps), ctypes.c_double(duration / steps))
        if library.play(body, *numbers, *arrays):
            raise MemoryError
        del kept
        states = np.moveaxis(states, 2, 3)
        return states[:, 0], states[:, 1]


@cache
def _library(lanes: int, dtype: type[np.floating], has_muscles: bool) -> ctypes.CDLL:
    formulas = [
        c_formula(function.__name__, function, *shapes) for function, shapes in FORMULAS.items()
    ]
    precision = "float" if dtype is np.float32 else "double"
    lines = [
        f"#define REAL {precision}",
        f"#define LANES {lanes}",
        f"#define MUSCLES {int(has_muscles)}",
        f"#define FORMULAS {' '.join(formulas)}",
        PROGRAM.read_text(encoding="utf-8"),
    ]
    library = compiled_library("\n".join(lines))
    if library is None:
        raise NeuroAnimatorError("Soft bodies need a C compiler: install gcc or clang.")
    return library


def _struct(
    body: SoftBody,
    movers: int,
    wind: Float[np.ndarray, "3 ..."],
    surfaces: Float[np.ndarray, " L"],
    dtype: type[np.floating],
) -> tuple[bytes, list[np.ndarray]]:
    """Return `body` as the struct Body of soft.c, and the arrays it points to, which must outlive it."""
    shortening = np.pad(body.muscles, ((0, 0), (0, MUSCLES_OF_A_SPRING)))
    strongest = np.argsort(-shortening, axis=1, kind="stable")[:, :MUSCLES_OF_A_SPRING]
    water = body.water or Water(face_drag=0.0)
    gravity = GRAVITY if body.water is None or water.has_gravity else (0.0, 0.0, 0.0)
    counts = {
        "nodes": len(body.positions),
        "pairs": len(body.pairs),
        "pair_colours": len(body.pair_colours) - 1,
        "tetrahedra": len(body.tetrahedra),
        "tetrahedron_colours": len(body.tetrahedron_colours) - 1,
        "faces": len(body.faces),
        "face_colours": len(body.face_colours) - 1,
        "pins": len(body.pins),
        "movers": movers,
        "capsules": len(body.capsules),
        "boxes": len(body.boxes),
        "planes": len(body.planes),
        "muscles": body.muscles.shape[1],
    }
    indices = {
        "pair": body.pairs,
        "pair_colour": body.pair_colours,
        "tetrahedron": body.tetrahedra,
        "tetrahedron_colour": body.tetrahedron_colours,
        "face": body.faces,
        "face_colour": body.face_colours,
        "pin": body.pins,
        "holder": body.holders,
        "capsule_mover": _each(body.capsules, "mover"),
        "box_mover": _each(body.boxes, "mover"),
        "plane_mover": _each(body.planes, "mover"),
        "muscle": np.minimum(strongest, max(body.muscles.shape[1] - 1, 0)),
    }
    reals = {
        "lightness": body.inverse_masses,
        "length": body.lengths,
        "compliance": 1 / body.stiffness,
        "damping": body.damping,
        "volume": body.volumes,
        "volume_compliance": 1 / body.bulk_stiffness,
        "held": body.held,
        "radius": _each(body.capsules, "radius"),
        "capsule_start": _each(body.capsules, "start"),
        "capsule_along": _each(body.capsules, "along"),
        "capsule_friction": _each(body.capsules, "friction"),
        "half": _each(body.boxes, "half"),
        "box_centre": _each(body.boxes, "centre"),
        "box_friction": _each(body.boxes, "friction"),
        "normal": _each(body.planes, "normal"),
        "plane_point": _each(body.planes, "point"),
        "plane_friction": _each(body.planes, "friction"),
        "wind": wind,
        "surface": surfaces,
        "shortening": np.take_along_axis(shortening, strongest, axis=1),
        "lift": lift_of(body.positions, body.masses, body.water),
    }
    kept = [np.ascontiguousarray(values, np.int32) for values in indices.values()]
    kept += [np.ascontiguousarray(values, dtype) for values in reals.values()]
    air = (body.air.drag, body.air.density / 2, MAX_AIR_SPEED)
    members = (
        *counts.values(),
        *[array.ctypes.data for array in kept],
        body.margin,
        *air,
        *gravity,
        *(water.face_drag, water.drag, water.depth),
        body.time_constant,
    )
    return struct.pack(f"{len(counts)}l{len(kept)}P11d", *members), kept


def _each(colliders: Iterable[Any], name: str) -> list[Any]:
    """Return an attribute of every collider."""
    return [getattr(collider, name) for collider in colliders]
