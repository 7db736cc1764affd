"""A mass-spring body as C: its numbers as constants, its springs, faces and matrix as straight-line code."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from jax import numpy as jnp
from jaxtyping import Array, Float, Int

from neuroanimator.codegen.c_formula import c_formula
from neuroanimator.physics.deformable.body import Body, point_forces
from neuroanimator.physics.deformable.body_parameters import (
    DAMPING_FACTOR,
    DENSITY_FACTOR,
    DRAG,
    FACE_DRAG,
    LENGTH,
    STIFFNESS_FACTOR,
    mass_of_point,
    own_values,
    spring_numbers,
    with_numbers,
)
from neuroanimator.physics.deformable.mass_spring import effective_stiffness
from neuroanimator.physics.water import face_forces, wetness

PROGRAM = Path(__file__).with_name("mass_spring.c")
"""Path of the loop, which is the same for every body."""

MAX_STATEMENTS = 1_000
"""Maximum number of unrolled statements of a kind; longer lists become loops, as compiling would take minutes.

So do all lists of bodies side by side, which share the look-up of a table's entry."""

ELIMINATION_STATEMENTS = 5
"""Ratio of the maximum number of statements of the elimination to that of a kind: there are several for each unknown."""

MAX_FORMULAS = 16
"""Maximum number of bodies whose formulas are kept: tracing them takes a tenth of a second."""

PADDING = 16
"""Number of entries to whose multiples arrays are padded with zeros: whole vectors."""

QUAD_CORNERS = 4
"""Number of corners of a quadrilateral face."""

Row = tuple[float, ...]
"""The arguments of a macro; integers are indices."""

Statements = tuple[str, list[tuple[int, ...]]]
"""A macro, and the indices of its repeated calls."""


def c_source(body: Body, precision: str, lanes: int) -> str:
    """Return the C program that steps `lanes` such bodies side by side in `precision`, `float` or `double`."""
    max_statements = MAX_STATEMENTS if lanes == 1 else 0
    sizes = {
        "REAL": precision,
        "LANES": lanes,
        "POINTS": len(body.masses),
        "SPRINGS": len(body.springs),
        "FACES": len(body.faces) if body.water else 0,
        "MUSCLES": body.muscles.shape[1],
        "CONTROLS": max(body.muscles.shape[1], body.external_forces.shape[1]),
        "PARAMETERS": len(body.varied),
        "TIME_CONSTANT": repr(float(body.time_constant)),
    }
    if body.water is not None and body.water.surface is not None:
        sizes["SURFACE"] = 1
    defines = [f"#define {name} {value}" for name, value in sizes.items()]
    lines = [
        *defines,
        *_numbers(body),
        *_settings(body),
        *_lists(body, max_statements),
        *_elimination(body, max_statements),
        f"#define FORMULAS {_formulas(body)}",
        PROGRAM.read_text(encoding="utf-8"),
    ]
    return "\n".join(lines)


@lru_cache(maxsize=MAX_FORMULAS)
def _formulas(body: Body) -> str:
    """Return the formulas of the JAX physics in C, each for one spring, mass point or face."""
    number = (1,)
    vector = (1, 3)

    def point_force(
        positions: Array, velocities: Array, mass: Array, lift: Array, wet: Array, *drag: Array
    ) -> Array:
        """Return the force on a mass point; for a family the drag of the water is an argument."""
        here = _in_water(body, "drag", drag)
        return point_forces(here, positions, velocities, mass, lift, wet)

    def corner_force(
        right: Array, up: Array, velocities: Array, wet: Array, share: Array, *face_drag: Array
    ) -> Array:
        """Return the force on each corner of a face; `velocities` is a sum over corners, `share` one over their number."""
        here = _in_water(body, "face_drag", face_drag).water
        assert here is not None
        return face_forces(here.face_drag, right, up, velocities, wet) * share**2

    of_water = (number,) if body.varied else ()
    spring = (vector, vector, number, number, number)
    point = (vector, vector, number, number, number, *of_water)
    face = (vector, vector, vector, number, number, *of_water)
    formulas = [
        c_formula("spring_stiffness", effective_stiffness, *spring),
        c_formula("wetness", partial(wetness, body.water), number),
        c_formula("point_force", point_force, *point),
    ]
    if body.water is not None:
        formulas.append(c_formula("corner_force", corner_force, *face))
    if body.varied:
        formulas.append(c_formula("spring_numbers", _spring_numbers, *[number] * 9))
        formulas.append(c_formula("mass_of_point", mass_of_point, number, number, number))
    return " ".join(formulas)


def _in_water(body: Body, name: str, given: tuple[Array, ...]) -> Body:
    """Return `body` in water of another drag, if one is `given`."""
    if body.water is None or not given:
        return body
    return with_numbers(body, water=replace(body.water, **{name: given[0]}))


def _spring_numbers(*numbers: Array) -> Float[Array, "1 3"]:
    return jnp.stack(spring_numbers(*numbers), axis=1)


def _settings(body: Body) -> Iterable[str]:
    """Yield the C expression of each target of a parameter: its own value, or the parameter that sets it."""
    if not body.varied:
        return
    own = own_values(body)
    numbers = {target: f"m->parameters[{place}][l]" for place, target in enumerate(body.varied)}
    terms = {target: f"(real){value!r}" for target, value in own.items()} | numbers
    growth = "1"
    if LENGTH in own:
        growth = f"({terms[LENGTH]} / (real){own[LENGTH]!r})"
    yield f"#define GROWTH {growth}"
    yield f"#define DENSITY {terms[DENSITY_FACTOR]}"
    yield f"#define STIFFNESS_FACTOR {terms[STIFFNESS_FACTOR]}"
    yield f"#define DAMPING_FACTOR {terms[DAMPING_FACTOR]}"
    yield f"#define FACE_DRAG {terms.get(FACE_DRAG, 0)}"
    yield f"#define DRAG {terms.get(DRAG, 0)}"
    for attribute in ("stiffness", "damping"):
        name = attribute.upper()
        places = []
        for group in body.spring_groups:
            target = f"spring/{group}/{attribute}"
            places.append(body.varied.index(target) if target in body.varied else -1)
        rows = ", ".join(map(str, places))
        yield f"static const int {name}_PARAMETER[] = {{{rows}}};"
        varies = f"{name}_PARAMETER[s] >= 0"
        yield f"#define GROUP_{name}(s) ({varies} ? m->parameters[{name}_PARAMETER[s]][l] : {name}[s])"


def _numbers(body: Body) -> Iterable[str]:
    """Yield the numbers of springs, mass points and faces."""
    arrays = {
        "STIFFNESS": body.stiffness,
        "DAMPING": body.damping,
        "LENGTH": body.lengths,
        "MASS": body.masses,
        "LIGHTNESS": 1 / body.masses,
        "LIFT": body.lift,
        "SHARE": body.face_shares.max(axis=1, initial=0),
    }
    if body.varied:
        along, *across = (body.extents**2).T
        arrays["ALONG"] = along
        arrays["ACROSS"] = sum(across)
        arrays["FORCE_DENSITY"] = body.force_densities
    for name, values in arrays.items():
        padding = -len(values) % PADDING or PADDING
        padded = [*values.tolist(), *[0.0] * padding]
        numbers = ", ".join(map(repr, padded))
        yield f"static const REAL {name}[] __attribute__((aligned(64))) = {{{numbers}}};"


def _lists(body: Body, max_statements: int) -> Iterable[str]:
    """Yield the lists X(...) X(...) that the program iterates over."""
    springs: list[Row] = [(spring, *ends) for spring, ends in enumerate(body.springs.tolist())]
    faces: list[Row] = []
    for face, corners in enumerate(body.faces.tolist()):
        has_fourth = len(set(corners)) == QUAD_CORNERS
        faces.append((face, *corners, int(has_fourth)))
    muscles: list[Row] = []
    for spring, muscle in np.argwhere(body.muscles).tolist():
        shortening = body.muscles[spring, muscle]
        if not body.varied:  # each body of a family has its own lengths
            shortening *= body.lengths[spring]
        muscles.append((spring, muscle, float(shortening)))
    mass = float(body.masses.sum())
    forces = []
    for axis, control in np.argwhere(body.external_forces).tolist():
        force = float(body.external_forces[axis, control])
        forces.append(f"X({axis}, {control}, {force / mass!r})")
    yield from _list("SPRING_LIST", springs, max_statements)
    yield from _list("FACE_LIST", faces, max_statements)
    yield from _list("MUSCLE_LIST", muscles, max_statements)
    yield "#define FORCE_LIST(X) " + " ".join(forces)


def _list(name: str, rows: Sequence[Row], max_statements: int) -> Iterable[str]:
    """Yield the macro `name`(X): X(...) for each of `rows`, or a loop over a table of them."""
    if len(rows) <= max_statements or not rows:
        calls = [f"X({', '.join(map(repr, row))})" for row in rows]
        yield f"#define {name}(X) " + " ".join(calls)
        return
    for column, values in enumerate(zip(*rows, strict=True)):
        has_fractions = any(isinstance(value, float) for value in values)
        number_type = "double" if has_fractions else "int"
        numbers = ", ".join(map(repr, values))
        yield f"static const {number_type} {name}_{column}[] = {{{numbers}}};"
    cells = ", ".join(f"{name}_{column}[row]" for column in range(len(rows[0])))
    yield f"#define {name}(X) for (int row = 0; row < {len(rows)}; row++) {{ X({cells}) }}"


def _elimination(body: Body, max_statements: int) -> Iterable[str]:
    """Yield the indices of the entries of the matrix M/δt + δt·K, and the program that eliminates and solves."""
    columns = fill_in(len(body.masses), body.springs)
    entries = _matrix_entries(columns)
    diagonal: list[Row] = [(k, k) for k in columns]
    matrix: list[Row] = []
    for spring, (a, b) in enumerate(body.springs.tolist()):
        matrix.append((spring, entries[a, a], entries[b, b], entries[a, b]))
    yield f"#define ENTRIES {max(entries.values()) + 1}"
    yield from _list("DIAGONAL_LIST", diagonal, max_statements)
    yield from _list("MATRIX_LIST", matrix, max_statements)
    steps = list(_elimination_steps(columns, entries))
    yield from _program("ELIMINATE", steps, max_statements)


def _matrix_entries(columns: dict[int, list[int]]) -> dict[tuple[int, int], int]:
    """Return the index of each entry of the symmetric matrix: the diagonal first, then the fill-in."""
    entries = {(k, k): k for k in columns}
    following = len(columns)
    for k, below in columns.items():
        for i in below:
            entries[k, i] = following
            entries[i, k] = following
            following += 1
    return entries


def _elimination_steps(
    columns: dict[int, list[int]], entries: dict[tuple[int, int], int]
) -> Iterable[Statements]:
    """Yield the statements that eliminate column after column, and those of the back substitution from the last one."""
    for k, below in columns.items():
        yield "PIVOT", [(k, k)]
        yield "COLUMN", [(i, k, entries[i, k]) for i in below]
        updates = []
        for number, i in enumerate(below):
            for j in below[: number + 1]:
                updates.append((entries[i, j], entries[i, k], entries[j, k]))
        yield "UPDATE", updates
    for k, below in reversed(columns.items()):
        yield "SCALE", [(k,)]
        yield "BACK", [(i, k, entries[i, k]) for i in below]


def _program(name: str, steps: Sequence[Statements], max_statements: int) -> Iterable[str]:
    """Yield the macro `name`: every step's statement for each of its rows, or loops over a table if that is long."""
    count = sum(len(rows) for _, rows in steps)
    if count <= ELIMINATION_STATEMENTS * max_statements:
        statements = []
        for macro, rows in steps:
            statements += [f"{macro}({', '.join(map(str, row))})" for row in rows]
        yield f"#define {name} " + " ".join(statements)
        return
    table: list[int] = []
    loops = []
    for macro, rows in steps:
        start = len(table)
        for row in rows:
            table += row
        width = len(rows[0]) if rows else 0
        cells = ", ".join(f"{name}_TABLE[row + {column}]" for column in range(width))
        loop = f"for (int row = {start}; row < {len(table)}; row += {width}) {{ {macro}({cells}) }}"
        loops.append(loop if rows else "")
    yield f"static const int {name}_TABLE[] = {{{', '.join(map(str, table))}}};"
    yield f"#define {name} " + " ".join(loops)


def fill_in(count: int, pairs: Int[np.ndarray, "P 2"]) -> dict[int, list[int]]:
    """Return, in order of elimination, each unknown and the later ones in its column: minimum degree first.

    `count` is the number of unknowns, `pairs` those connected by off-diagonal entries of the matrix.
    """
    linked: dict[int, set[int]] = {k: set() for k in range(count)}
    for a, b in pairs.tolist():
        linked[a].add(b)
        linked[b].add(a)
    columns: dict[int, set[int]] = {}
    while linked:
        k = min(linked, key=lambda unknown: (len(linked[unknown]), unknown))
        below = linked.pop(k)
        for i in below:
            linked[i] |= below - {i}
            linked[i].discard(k)
        columns[k] = below
    rank = {k: number for number, k in enumerate(columns)}
    return {k: sorted(below, key=rank.__getitem__) for k, below in columns.items()}
