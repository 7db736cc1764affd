"""Growth of a cloth emulator's state, hidden units and times with its nodes, beside the physics.

python benchmarks/law.py            100 to 10,000 nodes; five minutes on one core, and a quarter of an hour for 10,000
python benchmarks/law.py 100        the cloth of 100 nodes along an edge; the others' rows stay
python benchmarks/law.py --quick    small meshes and trainings, a minute; writes nothing

One cloth of 1 m × 1 m, in ever finer squares, hangs by its upper edge from a moving bar, damped by air. A super step
is 1/30 s, and the physics takes one small step for each node along an edge, at least 20: a wave passes as many edges.
Errors are of all nodes [% of the cloth's size, root mean square] along smooth unseen paths of the bar.

numbers        the fewest shapes that leave out at most 0.3 %
hidden_units   the narrowest of several hidden layers with which the emulator of these is off by at most 1 % after a second; none
               if no layer tried is
emulator_us    a super step of that emulator in C, latent
explicit_us    the same time by the physics: small steps of extended position-based dynamics in C
implicit_us    one step of backward Euler of the same springs: a sparse factorisation and its solution (SuperLU), nothing
               else of such a step

All of one cloth, on one core. Writes results/law.csv and docs/images/law.png.
"""

from __future__ import annotations

import argparse
import io
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from large_bodies import FRAME
from large_bodies_cases.equal_error import (
    STEPS,
    Test,
    controls_of,
    decoded,
    emulated_states,
    errors_of,
    known_states,
    unseen,
)
from matplotlib.figure import Figure
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu
from soft_meshes import grid_faces, obj_text, sheet

import neuroanimator as na
from neuroanimator.evaluation.csv_table import merge_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.speed import interleaved, one_core
from neuroanimator.files.atomic import write_whole
from neuroanimator.systems.loading import resolve
from neuroanimator.systems.soft.program import LANES
from neuroanimator.systems.soft.scene import Motion
from neuroanimator.systems.soft.soft_body import SoftBody
from neuroanimator.systems.soft.soft_system import SoftSystem
from neuroanimator.terminal import print_table

Rows = list[dict[str, Any]]

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
TABLE = RESULTS / "law.csv"
PICTURE = ROOT / "docs" / "images" / "law.png"

LEFT_OUT = 0.3
"""Error that shapes may leave [%]."""

MAX_ERROR = 1.0
"""Error of an emulator after a second that is good enough [%]."""

LEAST_STEPS = 20
"""Fewest small steps in a super step."""

TIMINGS = 5
"""Number of timings of each side; the median counts."""

TOML = """
name = "cloth"
kind = "soft"
mesh = "cloth.obj"
substeps = {steps}
shapes = {shapes}

[physics]
step = {step}
truth_step = {step}
fine_step = {fine_step}

[movers.bar]
position = [0.0, 0.0, 1.5]
speed = [1.0, 1.0, 0.5]
reach = [0.2, 0.2, 0.1]
pins = {pins}
"""


class Extent(NamedTuple):
    """How much is done for each mesh."""

    sides: tuple[int, ...]
    """Nodes along an edge."""
    shapes: int
    """Shapes among which those needed are counted."""
    widths: tuple[int, ...]
    """Hidden units tried, the fewest first."""
    count: int
    """Windows of data."""
    updates: int


THOROUGH = Extent((10, 17, 32, 55, 100), 96, (8, 16, 32, 64), 1_536, 2_000)
QUICK = Extent((6, 9), 24, (4, 16), 240, 500)


def made(folder: Path, side: int, shapes: int) -> tuple[SoftSystem, tuple[str, str, int]]:
    """Return the cloth with this number of nodes along an edge and of shapes; and its name, definition and substeps."""
    steps = max(LEAST_STEPS, side)
    (folder / "cloth.obj").write_text(obj_text(sheet(side), grid_faces(side, side)))
    text = TOML.format(
        steps=steps,
        shapes=shapes,
        step=FRAME / steps,
        fine_step=FRAME / steps / 2,
        pins=list(range(side)),
    )
    toml = folder / "cloth.toml"
    toml.write_text(text)
    system = na.load_system(str(toml))
    assert isinstance(system, SoftSystem)
    return system, resolve(str(toml))


def left_out(test: Test) -> Float[np.ndarray, " K"]:
    """Return the error that 1, 2, 3 and so on shapes leave along the test's runs [%]."""
    shapes = test.system.shapes
    squares = np.zeros(len(shapes.modes))
    whole = 0.0
    for frame, positions in enumerate(test.truth):
        nodes = np.moveaxis(positions, -1, 0).astype(float)
        away = nodes - test.paths[frame + 1].T[:, None] - shapes.mean
        whole += float((away**2).sum() / len(shapes.mean))
        squares += (shapes.project(away) ** 2).sum(axis=0)
    mean_squares = (whole - np.cumsum(squares)) / (STEPS * LANES)
    return 100 * np.sqrt(np.maximum(mean_squares, 0)) / test.system.scene.size


def trained(folder: Path, carried: tuple[str, str, int], width: int, extent: Extent) -> na.Emulator:
    """Return the emulator with this number of hidden units."""
    name, definition, substeps = carried
    data = folder / "data"
    if not data.exists():
        config = na.DatasetConfig.usual(name, definition, substeps, count=extent.count)
        na.generate(config, data)
    transitions = na.read_transitions(data)
    settings = na.TrainingConfig.usual(
        transitions.system.structure, widths=(width,), updates=extent.updates, batch=256
    )
    return na.train(transitions, settings, folder / f"cloth-{width}.emulator.safetensors")


def emulator_error(emulator: na.Emulator, test: Test) -> float:
    """Return the error after a second [%]."""
    path = emulated_states(emulator, test)
    return errors_of(test, decoded(test.system, path[:, 1:]))[f"error_{STEPS}_percent"]


def implicit_seconds(body: SoftBody) -> float:
    """Return the time of a factorisation of mass and stiffness, and of one solution with it [s]."""
    matrix = implicit_matrix(body)
    force = np.ones(matrix.shape[0])
    times = []
    for _ in range(TIMINGS):
        began = time.perf_counter()
        splu(matrix).solve(force)
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def implicit_matrix(body: SoftBody) -> csc_matrix:
    """Return M/h² + D/h + K of the nodes that are not held, at rest: symmetric, as a super step asks for it [N/m]."""
    first, second = body.pairs.T
    extent = body.positions[second] - body.positions[first]
    along = extent / np.linalg.norm(extent, axis=1, keepdims=True)
    strength = body.stiffness + body.damping / FRAME
    blocks = strength[:, None, None] * along[:, :, None] * along[:, None, :]
    free = np.ones(len(body.positions), bool)
    free[body.pins] = False
    axis = np.arange(3)
    rows = []
    columns = []
    values = []
    for one, other, sign in (
        (first, first, 1),
        (second, second, 1),
        (first, second, -1),
        (second, first, -1),
    ):
        row = 3 * one[:, None, None] + axis[:, None] + 0 * axis
        column = 3 * other[:, None, None] + axis + 0 * axis[:, None]
        rows.append(row.ravel())
        columns.append(column.ravel())
        values.append(sign * blocks.ravel())
    size = 3 * len(body.positions)
    diagonal = np.arange(size)
    rows.append(diagonal)
    columns.append(diagonal)
    values.append(np.repeat(body.masses / FRAME**2, 3))
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    kept = np.flatnonzero(np.repeat(free, 3))
    return coo_matrix(entries, shape=(size, size)).tocsc()[kept][:, kept]


def row_of(side: int, extent: Extent, folder: Path) -> dict[str, Any]:
    """Return the figures of the cloth with this number of nodes along an edge."""
    many, _ = made(folder, side, extent.shapes)
    errors = left_out(unseen(many, FRAME))
    within = np.flatnonzero(errors <= LEFT_OUT)
    numbers = int(within[0]) + 1 if len(within) else len(errors)
    system, carried = made(folder, side, numbers)
    test = unseen(system, FRAME)
    units: int | str = ""
    for width in extent.widths:
        emulator = trained(folder, carried, width, extent)
        error = emulator_error(emulator, test)
        if error <= MAX_ERROR:
            units = width
            break
    start = known_states(test)[0].astype(np.float32)
    controls = controls_of(test)[0].astype(np.float32)
    alone = Motion(*(np.ascontiguousarray(part[..., 0]) for part in test.start[:2]))
    steps = system.truth.steps(FRAME)
    seconds = interleaved(
        {
            "emulator": lambda: emulator.rollout(start, controls),
            "physics": lambda: system.scene.play(alone, test.paths[..., 0], FRAME, steps),
        },
        TIMINGS,
    )
    emulator_us = seconds["emulator"] / STEPS * 1e6
    explicit_us = seconds["physics"] / STEPS * 1e6
    implicit_us = implicit_seconds(system.scene.body) * 1e6
    return {
        "nodes": side * side,
        "small_steps": steps,
        "numbers": numbers,
        "left_out_percent": float(errors[numbers - 1]),
        "hidden_units": units,
        "error_1s_percent": error,
        "emulator_us": emulator_us,
        "explicit_us": explicit_us,
        "implicit_us": implicit_us,
        "explicit_over_emulator": explicit_us / emulator_us,
        "implicit_over_emulator": implicit_us / emulator_us,
    }


def numbers_of(rows: Rows, column: str) -> list[float]:
    """Return a column; rows that were read from the table hold text."""
    return [float(row[column]) for row in rows]


def draw(rows: Rows, path: Path) -> None:
    """Draw numbers, hidden units and times over nodes, each axis logarithmic."""
    nodes = numbers_of(rows, "nodes")
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    sizes, times = figure.subplots(1, 2)
    sizes.loglog(nodes, numbers_of(rows, "numbers"), "o-", color="#2b5a94", label="numbers")
    found = [row for row in rows if row["hidden_units"]]
    sizes.loglog(
        numbers_of(found, "nodes"),
        numbers_of(found, "hidden_units"),
        "s-",
        color="#e8892b",
        label="hidden units",
    )
    sizes.loglog(nodes, nodes, ":", color="grey", label="as many as nodes")
    for column, label, colour in (
        ("implicit_us", "physics, implicit", "#7a4f9a"),
        ("explicit_us", "physics, explicit", "#4fa3a0"),
        ("emulator_us", "emulator", "#e8892b"),
    ):
        times.loglog(nodes, numbers_of(rows, column), "o-", color=colour, label=label)
    times.set_ylabel("time of 1/30 s [µs]")
    for axes in (sizes, times):
        axes.set_xlabel("nodes of the cloth")
        axes.grid(which="both", alpha=0.2)
        axes.legend(fontsize="small")
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=110)
    write_whole(path, picture.getvalue())


def keep(row: dict[str, Any]) -> None:
    """Write a row into the table, in place of an older one of as many nodes, and draw all of it."""
    draw(merge_csv(TABLE, [row], "nodes", order=lambda one: int(one["nodes"])), PICTURE)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small meshes; writes no file")
    parser.add_argument("sides", nargs="*", type=int, help="nodes along an edge; all if none")
    arguments = parser.parse_args()
    extent = QUICK if arguments.quick else THOROUGH
    rows: Rows = []
    with one_core():
        for side in arguments.sides or extent.sides:
            with TemporaryDirectory() as folder:
                rows.append(row_of(side, extent, Path(folder)))
            print_table(rows[-1:])
            if not arguments.quick:
                keep(rows[-1])
    print(describe_machine())
    print_table(rows)


if __name__ == "__main__":
    main()
