"""A mass-spring body as C: its numbers as constants, its springs, faces and matrix as straight code."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from neuroanimator.systems.deformable.body import GRAVITY, Body
from neuroanimator.systems.deformable.mass_spring import MIN_LENGTH

PROGRAM = Path(__file__).with_name("mass_spring.c")

MAX_STATEMENTS = 1_000
"""Statements of a kind written out one after another; longer lists become loops, lest compiling take minutes.

So do all lists of bodies side by side, where looking up a place in a table is shared by all of them."""

PADDING = 16
"""Arrays end in zeros up to a whole number of vectors."""

Rows = Sequence[Sequence[float]]


def c_source(body: Body, precision: str, lanes: int) -> str:
    """Return the C program that steps `lanes` such bodies side by side in `precision`, `float` or `double`."""
    sizes = {
        "REAL": precision,
        "LANES": lanes,
        "POINTS": len(body.masses),
        "SPRINGS": len(body.springs),
        "FACES": len(body.faces) if body.water else 0,
        "MUSCLES": body.muscles.shape[1],
        "CONTROLS": max(body.muscles.shape[1], body.external_forces.shape[1]),
        "RESPONSE": repr(float(body.time_constant)),
        "SMALLEST_SQUARE": repr(MIN_LENGTH**2),
        **_surroundings(body),
    }
    most = MAX_STATEMENTS if lanes == 1 else 0
    defines = "\n".join(f"#define {name} {value}" for name, value in sizes.items())
    return "\n".join(
        [
            defines,
            *_numbers(body),
            *_lists(body, most),
            *_elimination(body, most),
            PROGRAM.read_text(encoding="utf-8"),
        ]
    )


def _surroundings(body: Body) -> dict[str, str]:
    """Return what is felt besides springs and faces; what is not defined costs nothing."""
    found: dict[str, float] = {"WEIGHT": GRAVITY} if body.has_gravity else {}
    if body.water is not None:
        water = body.water
        found |= {"DRAG": water.drag} if water.drag else {}
        if water.surface is not None:
            found |= {"SURFACE": water.surface, "DEPTH": water.depth}
    if body.ground is not None:
        found |= {f"GROUND_{name.upper()}": value for name, value in vars(body.ground).items()}
    return {name: repr(float(value)) for name, value in found.items()}


def _numbers(body: Body) -> Iterable[str]:
    """Yield the body's numbers; PUSH is for twice the area and the sum of the corners' speeds."""
    corners = np.array([len(set(face)) for face in body.faces.tolist()], float)
    push = body.water.face_drag if body.water else 0.0
    arrays = {
        "STIFFNESS": body.stiffness,
        "DAMPING": body.damping,
        "ELASTIC": body.stiffness * body.lengths,
        "MASS": body.masses,
        "LIGHTNESS": 1 / body.masses,
        "LIFT": body.lift,
        "PUSH": push / 2 / corners**2,
        "SHARE": 1 / corners,
    }
    for name, values in arrays.items():
        padded = [*values.tolist(), *[0.0] * (-len(values) % PADDING or PADDING)]
        yield f"static const REAL {name}[] __attribute__((aligned(64))) = {{{', '.join(map(repr, padded))}}};"


def _lists(body: Body, most: int) -> Iterable[str]:
    """Yield the lists X(...) X(...) that the program walks through."""
    springs, faces = body.springs.tolist(), body.faces.tolist()
    muscles = [
        (*map(int, index), float(body.muscles[tuple(index)])) for index in np.argwhere(body.muscles)
    ]
    external_forces = [
        (*map(int, index), float(body.external_forces[tuple(index)]))
        for index in np.argwhere(body.external_forces)
    ]
    mass = float(body.masses.sum())
    yield from _list("SPRING_LIST", [(i, *pair) for i, pair in enumerate(springs)], most)
    yield from _list(
        "FACE_LIST", [(i, *face, int(len(set(face)) == 4)) for i, face in enumerate(faces)], most
    )
    yield from _list("MUSCLE_LIST", muscles, most)
    yield "#define PUSH_LIST(X) " + " ".join(
        f"X({axis}, {number}, {n / mass!r})" for axis, number, n in external_forces
    )


def _list(name: str, rows: Rows, most: int) -> Iterable[str]:
    """Yield the macro `name`(X): X(...) for each of `rows`, or a loop over a table of them."""
    if len(rows) <= most or not rows:
        yield f"#define {name}(X) " + " ".join(f"X({', '.join(map(repr, row))})" for row in rows)
        return
    for column, values in enumerate(zip(*rows, strict=True)):
        kind = "double" if any(isinstance(value, float) for value in values) else "int"
        yield f"static const {kind} {name}_{column}[] = {{{', '.join(map(repr, values))}}};"
    cells = ", ".join(f"{name}_{column}[row]" for column in range(len(rows[0])))
    yield f"#define {name}(X) for (int row = 0; row < {len(rows)}; row++) {{ X({cells}) }}"


def _elimination(body: Body, most: int) -> Iterable[str]:
    """Yield where the entries of the matrix M/δt + δt·K lie, and the program that eliminates and solves."""
    columns = fill_in(len(body.masses), body.springs)
    entries = {(k, k): k for k in columns}
    for k, below in columns.items():
        for i in below:
            entries[k, i] = entries[i, k] = len(columns) + (len(entries) - len(columns)) // 2
    matrix = [
        (s, entries[a, a], entries[b, b], entries[a, b])
        for s, (a, b) in enumerate(body.springs.tolist())
    ]
    yield f"#define ENTRIES {max(entries.values()) + 1}"
    yield from _list("DIAGONAL_LIST", [(k, k) for k in columns], most)
    yield from _list("MATRIX_LIST", matrix, most)
    forward, back = [], []
    for k, below in columns.items():
        forward.append(("PIVOT", [(k, k)]))
        forward.append(("COLUMN", [(i, k, entries[i, k]) for i in below]))
        pairs = [(i, j) for n, i in enumerate(below) for j in below[: n + 1]]
        forward.append(
            ("UPDATE", [(entries[i, j], entries[i, k], entries[j, k]) for i, j in pairs])
        )
    for k, below in reversed(columns.items()):
        back += [("SCALE", [(k,)]), ("BACK", [(i, k, entries[i, k]) for i in below])]
    yield from _program("ELIMINATE", forward + back, most)


def _program(name: str, parts: list[tuple[str, list[tuple[int, ...]]]], most: int) -> Iterable[str]:
    """Yield the macro `name`: every part's statement for each of its rows, or loops over a table where that is long."""
    if sum(len(rows) for _, rows in parts) <= 5 * most:
        statements = (
            f"{macro}({', '.join(map(str, row))})" for macro, rows in parts for row in rows
        )
        yield f"#define {name} " + " ".join(statements)
        return
    table, loops = [], []
    for macro, rows in parts:
        width = len(rows[0]) if rows else 0
        cells = ", ".join(f"{name}_TABLE[row + {column}]" for column in range(width))
        end = len(table) + width * len(rows)
        loops.append(
            f"for (int row = {len(table)}; row < {end}; row += {width}) {{ {macro}({cells}) }}"
            if rows
            else ""
        )
        table += [number for row in rows for number in row]
    yield f"static const int {name}_TABLE[] = {{{', '.join(map(str, table))}}};"
    yield f"#define {name} " + " ".join(loops)


def fill_in(count: int, pairs: np.ndarray) -> dict[int, list[int]]:
    """Return, in order of elimination, each unknown and the later ones its column reaches: minimum degree first."""
    linked: dict[int, set[int]] = {k: set() for k in range(count)}
    for a, b in pairs.tolist():
        linked[a].add(b)
        linked[b].add(a)
    columns: dict[int, list[int]] = {}
    while linked:
        k = min(linked, key=lambda each: (len(linked[each]), each))
        below = linked.pop(k)
        for i in below:
            linked[i] |= below - {i}
            linked[i].discard(k)
        columns[k] = sorted(below)
    rank = {k: n for n, k in enumerate(columns)}
    return {k: sorted(below, key=rank.__getitem__) for k, below in columns.items()}
