"""Proposal for a mesh: a cloth held by its upper edge, and a ball that strikes it; or a solid, and a paddle."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.soft import MAX_MUSCLES, SOLID_ENDING, MeshReading, SoftDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.files.atomic import read_bounded
from neuroanimator.files.tables import check_table
from neuroanimator.learn.data.config import (
    SAMPLES_PER_RUN,
    SOFT_COUNT,
    SWIMMER_COUNT,
    USUAL_SAMPLES_PER_RUN,
)
from neuroanimator.physics.soft.mesh import Mesh
from neuroanimator.physics.soft.mesh_file import MAX_FILE, read_mesh
from neuroanimator.physics.soft.scene import Scene
from neuroanimator.physics.soft.soft_body import GRAVITY, Points
from neuroanimator.physics.soft.soft_system import SWIM_STEPS, THROW_STEPS, SoftSystem
from neuroanimator.scaffold.character import propose_movers
from neuroanimator.scaffold.defaults import rounded, usual_name
from neuroanimator.scaffold.proposal import Proposal
from neuroanimator.scaffold.teacher import data_row
from neuroanimator.state.shape_contacts import FREE
from neuroanimator.text import listed

STEP = 1 / 1200
"""Small physics step [s]."""

TRUTH_PARTS = 2
"""Number of the teacher's small steps in one of those."""

FINE_PARTS = 10
"""Number of the reference's small steps in one of those."""

CONSTRAINT_SECONDS = 3e-9
"""Time of a core for a spring or tetrahedron in a small step [s], as measured for 600 to 85,000 of them."""

COLLISIONS = 2
"""Number of nodes and colliders of which the distances take as long as that."""

USUAL_SIZES = (0.01, 20.0)
"""Smallest and largest size that is taken for one in metres [m]: from a button to a tent."""

TALL_IN_MM = 300.0
"""Size from which a mesh that is too large is rather in millimetres than in centimetres."""

LOW = 0.7
"""Height over depth below which a body may have been saved with Y up."""

EDGES = (0.01, 0.03, 0.1)
"""Widths of the upper edge, over the size of the mesh: the first with enough nodes, so that a ball does not hang by one."""

ENOUGH = 3
"""That number of nodes."""

BALL = 0.15
"""Radius of the ball, over the size of the mesh."""

AWAY = 0.6
"""Least distance of the ball at rest from the middle, over the size of the mesh."""

DENSITY = 1000.0
"""Density [kg/m³]."""

SAG = 0.05
"""Strain at the bottom of a body as high as its size, under its own weight."""

HARDER = 10.0
"""Bulk modulus over Young's modulus."""

FACE_DRAG = 800.0
"""Drag of the faces of a swimmer 1 m long [kg/(m²·s)]; it grows with the root of the length, as speeds do."""

SWIMMER_DAMPING = 4e-3
"""Internal friction of flesh [s]."""

STROKE = 0.33
"""Period of a proposed gait [s]: muscles follow as fast in a large body as in a small one."""

STROKE_LAG = 1.0
"""Lag of the rearmost muscle behind the foremost [rad]."""

OFF_CENTRE = 0.2
"""Distance from the middle at which a muscle is on a side, over that of the muscle farthest from it."""

TAIL = 0.15
"""Share of a body's length that counts as its tail."""

PADDLE = (0.1, 0.4, 0.4)
"""Half the size of the paddle, over the size of the body."""

GAP = 0.2
"""Least distance of the ball or the paddle at rest from the body, over the size of the body."""

FREE_ROW = (
    "held",
    "by nothing: it lies on the ground, and an emulator follows it until it tumbles",
)
"""Row for the screen about a body that nothing holds: its tumbling is chaotic."""

NO_MUSCLES_ROW = (
    "muscles",
    'none: its mesh does not name two groups or more of tetrahedra (Gmsh: Physical Volume("left") = {1};)',
)
"""Row for the screen about a solid without muscles."""

COMMENTS = {
    "unit": "of the mesh's numbers",
    "up": "the mesh's axis that points up",
    "keep": "which pieces of the mesh",
    "substeps": "small steps in a super step",
    "shapes": "amplitudes that describe the body; more are more accurate and slower. Computed when first needed",
    "physics": "Small steps [s]: a user's, the teacher's, and the reference's.",
    "cloth": "Material: density [kg/m²], stretch [N/m], bend [N/m], damping [s], thickness [m].",
    "solid": "Material: density [kg/m³], stretch (Young's modulus) and bulk modulus [Pa], damping [s].",
    "ground": "A level plane: height [m].",
    "muscles": "Groups of tetrahedra that shorten along a direction: each is a control from 0 to 1.",
    "water": "Water: drag of faces [kg/(m²·s)], height of the centre of buoyancy over that of mass [m].",
    "gait": "The default way to swim: amplitude of each muscle, and its lag behind the first [rad]; period of a stroke [s].",
    "sampling": "Random starts of training runs.",
    "air": "Air: drag [1/s], density [kg/m³], wind [m/s].",
    "movers": "What moves: a control is its velocity, at most `speed` [m/s], and its turning rate. Its colliders strike; "
    "nodes that are its `pins` go with it.",
}
"""Comments on the values of the TOML file."""


def propose_soft(path: Path, given: MeshReading, character: Path | None = None) -> Proposal:
    """Return a definition of the body whose mesh is in the file at `path`: a cloth (OBJ) or a solid (Gmsh).

    `given` is how the mesh is meant; what it leaves open is asked about if the size is unlikely. The bones of a `character`,
    a GLB file beside the mesh, hold and strike a cloth. Raises BadFileError or ArgumentError for a file that is not such a
    mesh.
    """
    mesh = read_mesh(path.name, read_bounded(path, MAX_FILE), given)
    size = float(np.ptp(mesh.positions, axis=0).max())
    if "unit" not in given.model_fields_set:
        _ask_for_unit(path.name, mesh.positions)
    is_solid = path.suffix == SOLID_ENDING
    if is_solid and character is not None:
        raise ArgumentError("character: bones hold a cloth, an OBJ file. Leave it out.")
    # A group alone names the material.
    has_muscles = 2 <= len(mesh.groups) <= MAX_MUSCLES
    if has_muscles:
        own = _swimmer_values(mesh, size)
        rows = [("muscles", f"{listed(mesh.groups)}, along the longest side of each")]
    elif is_solid:
        own = _solid_values(mesh.positions, size)
        rows = [FREE_ROW, NO_MUSCLES_ROW]
    else:
        pins, edge = _held_edge(mesh.positions, size)
        own = _cloth_values(mesh.positions, size, pins)
        rows = [("held", f"{len(pins)} nodes: {edge}")]
        if character is not None:
            margin = own["cloth"]["thickness"]
            own["movers"], of_bones, has_motions = propose_movers(
                character, mesh.positions, pins, margin
            )
            rows += of_bones
            if has_motions:
                own["motions"] = character.name
    values = {
        "name": usual_name(path),
        "kind": "soft",
        "mesh": path.name,
        **given.model_dump(),
        "substeps": 40,
        "shapes": 96,
        "physics": {
            "step": STEP,
            "truth_step": STEP / TRUTH_PARTS,
            "fine_step": STEP / FINE_PARTS,
        },
        **own,
    }
    definition = check_table(values, path.name, SoftDefinition)
    scene = Scene(definition, mesh)  # refuses invalid values
    kind = "tetrahedra" if is_solid else "triangles"
    count = f"{len(mesh.positions):,} nodes, {len(mesh.elements):,} {kind}, {size:g} m"
    told = [("mesh", count)]
    if mesh.mended:
        told.append(("mended", "; ".join(mesh.mended)))
    told += rows
    colliders = len(scene.body.capsules) + len(scene.body.boxes)
    constraints = len(scene.body.pairs) + len(scene.body.tetrahedra)
    constraints += colliders * len(mesh.positions) // COLLISIONS
    count, frames = SOFT_COUNT, data_steps(scene.anchor == FREE)
    parts = tuple(own["movers"]) if "movers" in own else ()
    parts += tuple(f"{name}_velocity" for name in parts)
    if has_muscles:
        count, frames = SWIMMER_COUNT, swimming_steps(definition)
        parts = ("position", "orientation", "velocity", "activations")
    elif is_solid:
        parts = ("paddle", "paddle_heading", "position", "velocity")
    steps = definition.substeps * TRUTH_PARTS * frames
    seconds = steps * constraints * CONSTRAINT_SECONDS
    told.append(data_row(count, seconds))
    warnings = tuple(_warnings(mesh.positions, given, is_solid))
    return Proposal(definition, COMMENTS, parts, warnings, tuple(told), seconds)


def data_steps(is_free: bool) -> float:
    """Return the number of super steps in the usual data."""
    run_steps = THROW_STEPS if is_free else SoftSystem.run_steps
    return SOFT_COUNT / SAMPLES_PER_RUN * run_steps


def swimming_steps(definition: SoftDefinition) -> float:
    """Return the number of super steps in the usual data of a body with muscles: runs, and their warm-up."""
    warm_up = definition.sampling.warm_up / (definition.substeps * definition.physics.step)
    return SWIMMER_COUNT / USUAL_SAMPLES_PER_RUN * (SWIM_STEPS + warm_up)


def _ask_for_unit(name: str, positions: Points) -> None:
    """Raise ArgumentError for a mesh that is unlikely to be in metres."""
    extents = np.ptp(positions, axis=0)
    size = float(extents.max())
    told = f"{name}: {size:.4g} m {'tall' if extents[2] > 0.99 * size else 'long'}"
    smallest, largest = USUAL_SIZES
    if size > largest:
        words = "in millimetres? --unit mm (or cm, in)"
        if size < TALL_IN_MM:
            words = "in centimetres? --unit cm (or in, mm)"
        raise ArgumentError(f"{told}: {words}. If it is that large: --unit m.")
    if size < smallest:
        raise ArgumentError(f"{told}: scale it where you made it. If it is that small: --unit m.")


def _warnings(positions: Points, given: MeshReading, is_solid: bool) -> Iterator[str]:
    """Yield warnings for the user, one line each: about an unlikely size, and a body that lies though it may stand."""
    width, depth, height = np.ptp(positions, axis=0).tolist()
    size = max(width, depth, height)
    if not USUAL_SIZES[0] <= size <= USUAL_SIZES[1]:
        yield f"mesh: with --unit {given.unit} the body is {size:.4g} m large."
    lies = height < LOW * min(depth, width) or (height < LOW * depth and width < LOW * depth)
    if is_solid:
        lies = max(width, height) < LOW * depth
    if lies and "up" not in given.model_fields_set:
        yield (
            f"mesh: it lies, {depth:.3g} m from front to back and {height:.3g} m high. If it should hang or stand, it was "
            "saved with Y up (as Blender and Maya do by default): --up y. As it is: --up z."
        )


def _cloth_values(positions: Points, size: float, pins: np.ndarray) -> dict[str, Any]:
    """Return the material and the movers of a cloth."""
    low = positions.min(axis=0)
    middle = (low + positions.max(axis=0)) / 2
    across = _axes(positions)[-1]  # along which it extends least
    extent = float(((positions - middle) @ across).max())
    away = max(AWAY * size, extent + (BALL + GAP) * size)
    return {
        "cloth": {"density": 0.2, "stretch": 20.0, "bend": 0.5, "thickness": _rounded(0.01 * size)},
        "air": {"drag": 0.5, "density": 1.2, "wind": [0.0, 0.0, 0.0]},
        "movers": {
            "holder": {
                "position": _rounded(positions[pins].mean(axis=0)),
                "speed": [_rounded(0.5 * size)] * 3,
                "reach": [_rounded(0.15 * size)] * 3,
                "pins": pins.tolist(),
            },
            "ball": {
                "position": _rounded(middle + away * across),
                "speed": [_rounded(size)] * 3,
                "reach": _rounded(size * (0.25 + 0.75 * np.abs(across))),
                "colliders": [{"radius": _rounded(BALL * size)}],
            },
        },
    }


def _solid_values(positions: Points, size: float) -> dict[str, Any]:
    """Return the material of a solid, the ground under it, and the movers."""
    low = positions.min(axis=0)
    half = size * np.array(PADDLE)
    paddle = (low + positions.max(axis=0)) / 2
    paddle[0] = low[0] - GAP * size - half[0]
    paddle[2] = low[2] + half[2]
    return {
        "solid": _solid(size),
        "ground": {"height": _rounded(low[2]), "friction": 0.5},
        "movers": {
            "paddle": {
                "position": _rounded(paddle),
                "speed": [_rounded(5 * size)] * 3,
                "reach": _rounded(size * np.array([0.6, 0.4, 0.3])),
                "turns": True,
                "turn_speed": 3.0,
                "turn_reach": 0.5,
                "colliders": [{"box": _rounded(half)}],
            },
        },
    }


def _swimmer_values(mesh: Mesh, size: float) -> dict[str, Any]:
    """Return the material, the muscles and the water of a solid whose mesh has groups."""
    along = {}
    centres = []
    for number, name in enumerate(mesh.groups):
        inside = mesh.positions[mesh.elements[mesh.members == number]].mean(axis=1)
        along[name] = _rounded(_longest_axis(inside))
        centres.append(inside.mean(axis=0))
    own = {
        "shapes": 32,
        "solid": _solid(size) | {"damping": SWIMMER_DAMPING},
        "muscles": {"along": along},
        "water": {
            "face_drag": rounded(FACE_DRAG * np.sqrt(size), 2),
            "righting": _rounded(0.01 * size),
        },
        "sampling": {
            "warm_up": 0.3,
            "velocity": _rounded(np.array([0.4, 0.1, 0.1]) * size),
            "angular_velocity": 0.5,
            "tilt": 0.5,
        },
    }
    gait = _gait(mesh.positions, dict(zip(along, centres, strict=True)))
    return own | ({"gait": gait} if gait else {})


def _gait(positions: Points, muscles: dict[str, Float[np.ndarray, " 3"]]) -> dict[str, Any]:
    """Return a wave of the `muscles`, by the centre of each [m], towards the tail; nothing if all are on one side.

    The tail beats across its broad side: those of a fish pull in turn on the left and on the right, those of a dolphin above
    and below.
    """
    rear = positions[:, 0] < positions[:, 0].min() + TAIL * np.ptp(positions[:, 0])
    width, height = np.ptp(positions[rear, 1:], axis=0)
    centres = np.array(list(muscles.values())) - positions.mean(axis=0)
    across = centres[:, 2 if width > height else 1]
    sides = np.where(np.abs(across) > OFF_CENTRE * np.abs(across).max(), np.sign(across), 0.0)
    if not sides.min() < 0 < sides.max():
        return {}
    behind = centres[:, 0].max() - centres[:, 0]
    lags = STROKE_LAG * behind / max(behind.max(), np.finfo(float).tiny)
    waves = np.stack([sides, lags], axis=1).round(2).tolist()
    return {"period": STROKE, "controls": dict(zip(muscles, waves, strict=True))}


def _solid(size: float) -> dict[str, float]:
    """Return the material of a solid that sags a little under its own weight."""
    stretch = rounded(-DENSITY * GRAVITY[2] * size / SAG, 2)
    return {"density": DENSITY, "stretch": stretch, "bulk": HARDER * stretch}


def _held_edge(positions: Points, size: float) -> tuple[np.ndarray, str]:
    """Return the nodes of the upper edge, or of one side of a level mesh; and a name for them."""
    along = positions[:, 2]
    name = "the upper edge"
    if np.ptp(along) <= EDGES[0] * size:
        along = -positions[:, 0]
        name = "the side of smallest x"
    widths = list(EDGES)
    pins = np.zeros(0, int)
    while len(pins) < ENOUGH and widths:
        pins = np.flatnonzero(along > along.max() - widths.pop(0) * size)
    return pins, name


def _longest_axis(positions: Points) -> Float[np.ndarray, " 3"]:
    """Return the unit vector along which points extend most, forward."""
    axis = _axes(positions)[0]
    return axis if axis[0] >= 0 else -axis


def _axes(positions: Points) -> Float[np.ndarray, "3 3"]:
    """Return the principal axes of points, in rows, the longest first."""
    _, _, axes = np.linalg.svd(positions - positions.mean(axis=0), full_matrices=False)
    return axes


def _rounded(values: Any) -> Any:
    """Return numbers rounded for a TOML file, to whole micrometres."""
    return np.round(values, 6).tolist()
