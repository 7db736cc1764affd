"""Bodies of thousands of nodes; each part writes results/large_bodies_PART.csv.

python benchmarks/large_bodies.py equal_error [cape flag jelly]   emulators that ship beside the physics: error and time
python benchmarks/large_bodies.py physics                         a cloth in C, by mesh and small steps: time, convergence
python benchmarks/large_bodies.py sheet [cape flag jelly]         docs/images/soft-bodies.png: physics and emulators
python benchmarks/large_bodies.py flex [cape flag jelly]          the same meshes as flexes of MuJoCo, whole and reduced
python benchmarks/large_bodies.py fidelity [cape flag jelly]      emulators that ship: wrinkles, a million super steps
python benchmarks/large_bodies.py gradients [cape flag jelly]     emulators that ship: their gradients, and what limits them
python benchmarks/large_bodies.py fidelity jelly --quick          one path, short runs; writes nothing
python benchmarks/large_bodies.py own_flex [cloth jelly]          a user's own flexes, from `new` on; --folder keeps all files

Equal error: runs of 1 s along smooth random paths of the movers that training never saw, some time after rest. The truth is
the teacher's physics with all nodes. The emulator is compared with the physics started from its state (nodes decoded from the
shapes), the initial shape carried along, and cheaper physics: fewer small steps, coarser meshes, whose nodes are interpolated.
Errors are of all nodes [% of the body's size, root mean square]: mean and 95th percentile of runs; of normals the mean angle.
Times are of one core, one body, in float32, in turn. A factor is the time of the cheapest physics that is as accurate as the
emulator, over the emulator's.

Physics: a cloth of 1 m hangs by its upper edge from a moving bar, and a ball of 0.15 m passes through it: 1 s
from rest. Times are of one core in float32: of one cloth, and of one of sixteen side by side. Differences are of all
nodes, root mean square, from the same mesh in the most small steps, and from the finest mesh in equally many, at common nodes.

Gradients: along the same paths as equal error. The cost is the squared distance of one node (a cloth's lowest corner, the top of
the jelly), of the mean of the patch within 0.1 sizes of it, or of all nodes, from a point, after 0.5 s; the gradient is with
respect to all controls, or to six knots of splines. Results are cosines between the emulator's gradient, as in descents, and
central differences of the physics with all nodes, by a step of 2 % of a control's largest rate, for some runs also 10 %. Compared
are the gradient of a body carried along rigidly, differences of the physics whose node is read through the shapes at the end, and
of physics that starts every super step from the shapes: the result of an emulator without error.

Fidelity: along the same paths, for 5 s. Spectra, by octaves, are of the nodes' displacements from rest: by cosines over the
mesh's grid after 1 s, and in time. A million super steps go along random paths. Penetration is the distance that a node, or the
middle of a face, must move to leave a collider: of the physics, the emulator, and the emulator as drawn. Also writes
results/large_bodies_spectra.csv and docs/images/soft-spectra.png.

Flex: cape, flag and jelly as MuJoCo's flexes, attached to the same movers, from rest, for 1 s along
a smooth random path that does not turn; without air, and without colliders. Materials follow the definitions as far
as MuJoCo has them. `full` is the whole mesh, elastic; `full, edges as equalities` a cloth as in MuJoCo's documentation,
shown with its time alone; `trilinear` and `quadratic` are MuJoCo's reduced bodies, with 8 and 27 nodes of a surrounding
box. Errors are of all nodes [% of the size, root mean square], from `full` in 64 steps per super step. All are timed in
turn with the emulator's super step.

Own flexes: two typical MuJoCo models (large_bodies_cases/models), a cloth of 225 nodes tied to a bar
and a jelly of 216 on the ground that a paddle strikes, taken without an edit from `new` to an emulator, with half (cloth)
and a quarter (jelly) of the usual data and updates. Errors are those of equal error, the physics MuJoCo's in the teacher's,
the model's own and longer steps.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from large_bodies_cases.equal_error import equal_error_rows, shipped, unseen
from large_bodies_cases.families import FAMILIES
from large_bodies_cases.flex import flex_rows
from large_bodies_cases.gradients import gradient_columns
from large_bodies_cases.limits import endurance_columns, penetration_columns
from large_bodies_cases.own_flex import EXTENTS, own_flex_rows
from large_bodies_cases.own_flex import QUICK as QUICK_FLEX
from large_bodies_cases.sheet import draw_sheet
from large_bodies_cases.spectra import Spectrum, band_rows, draw_spectra, spectra_of

from neuroanimator.definitions.soft import ClothTable
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.speed import one_core
from neuroanimator.systems.soft.mesh import Mesh
from neuroanimator.systems.soft.meshes import cloth_body
from neuroanimator.systems.soft.program import LANES, SoftProgram
from neuroanimator.systems.soft.soft_body import Air, Capsule, SoftBody
from neuroanimator.terminal import print_table, progress_bar

Rows = list[dict[str, Any]]

PARTS = ("physics", "equal_error", "sheet", "flex", "own_flex", "fidelity", "gradients")

RESULTS = Path(__file__).parent / "results"

IMAGES = Path(__file__).parent.parent / "docs" / "images"

PICTURE = IMAGES / "soft-bodies.png"

SPECTRA = IMAGES / "soft-spectra.png"

CELLS = (9, 18, 36, 72)
"""Numbers of squares along an edge of the cloth."""

STEPS = (10, 20, 40, 80, 160)
"""Numbers of small steps a frame; the last is what others are compared with."""

FRAME = 1 / 30
"""Time of a frame [s]."""

FRAMES = 30
"""Number of frames, from rest."""

ROUNDS = 3
"""Number of timings; the least counts."""

BALL = 0.15
"""Radius of the ball [m]."""


class Extent(NamedTuple):
    """How much is done for the fidelity of each body."""

    paths: int
    """Of gradients."""
    length: int
    """Super steps of the runs beside the physics."""
    super_steps: int
    """Of the long run."""


THOROUGH = Extent(paths=8, length=150, super_steps=1_000_000)
QUICK = Extent(paths=1, length=60, super_steps=10_000)

BARS = {
    "node_controls_median": 0.9,
    "node_controls_least": 0.9,
    "node_knots_median": 0.9,
    "node_knots_least": 0.9,
    "drawn_node_mm": 1.0,
    "drawn_face_mm": 1.0,
}
"""What is wanted of a quantity: of a gradient at least, of a depth at most."""


def square(cells: int) -> SoftBody:
    """Return a cloth of 1 m × 1 m in triangles, hung by its upper edge."""
    line = np.linspace(0, 1, cells + 1)
    x, z = np.meshgrid(line - 0.5, -line)
    nodes = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    corners = (nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:])
    a, b, c, d = (corner.ravel() for corner in corners)
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return cloth_body(
        Mesh(np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1), faces),
        ClothTable(density=0.2, stretch=20.0, bend=0.5),
        nodes[0],
        air=Air(drag=0.5, density=1.2),
        capsules=(Capsule(BALL, friction=0.3, mover=1),),
        margin=0.005,
    )


def poses() -> np.ndarray:
    """Return where the bar and the ball are, and that they do not turn (T+1, 2, 4) [m]."""
    now = np.arange(FRAMES + 1) * FRAME
    bar = np.stack([0.1 * np.sin(2 * np.pi * 0.4 * now), 0 * now, 0 * now], axis=1)
    ball = np.stack([0.05 + 0 * now, 0.5 - 0.6 * now, -0.55 + 0 * now], axis=1)
    movers = np.zeros((FRAMES + 1, 2, 4))
    movers[:, 0, :3] = bar
    movers[:, 1, :3] = ball
    return movers


def run(body: SoftBody, steps: int, lanes: int) -> tuple[np.ndarray, float]:
    """Return the last positions (N, 3, ...) and the processor time of a frame of one cloth [ms]."""
    parts = (body.positions, np.zeros_like(body.positions), poses())
    if lanes > 1:
        parts = tuple(np.repeat(part[..., None], lanes, axis=-1) for part in parts)
    positions, velocities, movers = parts
    program = SoftProgram(body, lanes)
    ends = []
    times = []
    for _ in range(ROUNDS):
        began = time.process_time()
        path, _ = program.play(positions, velocities, movers, FRAME, steps)
        times.append(time.process_time() - began)
        ends.append(path[-1])
    return ends[-1], min(times) / FRAMES / lanes * 1e3


def physics_rows() -> Rows:
    """Return a row per mesh and number of small steps."""
    rows: Rows = []
    finest = max(CELLS)
    ends: dict[tuple[int, int], np.ndarray] = {}
    with progress_bar("cloth", len(CELLS) * len(STEPS)) as bar:
        for cells in reversed(CELLS):
            body = square(cells)
            run(body, 1, LANES)  # compiles
            for steps in reversed(STEPS):
                end, alone = run(body, steps, 1)
                _, together = run(body, steps, LANES)
                grid = end.reshape(cells + 1, cells + 1, 3)
                ends[cells, steps] = grid
                stride = finest // cells
                fine = ends[finest, max(STEPS)][::stride, ::stride]
                rows.append(
                    {
                        "nodes": len(body.positions),
                        "small_steps": steps,
                        "frame_ms": alone,
                        "frame_of_sixteen_ms": together,
                        "ns_a_node_and_step": alone * 1e6 / len(body.positions) / steps,
                        "from_most_steps_percent": difference(grid, ends[cells, max(STEPS)]),
                        "from_finest_mesh_percent": difference(grid, fine),
                    }
                )
                bar.advance_to(len(rows))
    return rows


def difference(first: np.ndarray, second: np.ndarray) -> float:
    """Return the root mean square distance of nodes [% of the cloth's size]."""
    return 100 * float(np.sqrt(((first - second) ** 2).sum(axis=-1).mean()))


def equal_error(names: list[str]) -> None:
    """Print and write each body's rows, and its factors at equal error."""
    rows: Rows = []
    found: Rows = []
    for name in names:
        of_body, factors = equal_error_rows(name)
        rows += of_body
        found += factors
        print_table(of_body)
    print_table(found)
    if len(names) == len(FAMILIES):
        write_csv(RESULTS / "large_bodies_errors.csv", rows)
        write_csv(RESULTS / "large_bodies_factors.csv", found)


Columns = dict[str, Any]
"""Quantities of one body by their names."""


def fidelity_of(name: str, extent: Extent) -> tuple[Columns, dict[str, Spectrum]]:
    """Return the figures of a body, and its spectra."""
    system, emulator = shipped(name)
    test = unseen(system, emulator.dt, length=extent.length)
    columns: Columns = {}
    columns |= endurance_columns(test, emulator, extent.super_steps)
    columns |= penetration_columns(test, emulator)
    return columns, spectra_of(test, emulator)


def fidelity(names: list[str], extent: Extent) -> None:
    """Print each body's figures and spectra; write those of all."""
    found: dict[str, Columns] = {}
    spectra: dict[str, dict[str, Spectrum]] = {}
    for name in names:
        found[name], spectra[name] = fidelity_of(name, extent)
    rows, bands = fidelity_tables(found, spectra)
    print_table(rows)
    print_table(bands)
    if len(names) == len(FAMILIES) and extent == THOROUGH:
        write_csv(RESULTS / "large_bodies_fidelity.csv", rows)
        write_csv(RESULTS / "large_bodies_spectra.csv", bands)
        draw_spectra(spectra, SPECTRA)


def fidelity_tables(
    found: dict[str, Columns], spectra: dict[str, dict[str, Spectrum]]
) -> tuple[Rows, Rows]:
    """Return (a row per quantity with a column for each body, a row per body and octave)."""
    bands: Rows = []
    for name, of_body in spectra.items():
        bands += band_rows(name, of_body)
    return quantity_rows(found), bands


def gradients(names: list[str], paths: int) -> None:
    """Print each body's cosines, of `paths` runs; write those of all."""
    found: dict[str, Columns] = {}
    for name in names:
        system, emulator = shipped(name)
        found[name] = gradient_columns(unseen(system, emulator.dt), emulator, paths)
    rows = quantity_rows(found)
    print_table(rows)
    if len(names) == len(FAMILIES) and paths == THOROUGH.paths:
        write_csv(RESULTS / "large_bodies_gradients.csv", rows)


def quantity_rows(found: dict[str, Columns]) -> Rows:
    """Return a row per quantity with a column for each body."""
    rows: Rows = []
    for quantity in next(iter(found.values())):
        row: dict[str, Any] = {"quantity": quantity}
        row |= {name: columns[quantity] for name, columns in found.items()}
        rows.append(row | {"bar": BARS.get(quantity, "")})
    return rows


def own_flex(names: list[str], folder: Path | None, *, is_quick: bool) -> None:
    """Print and write each model's rows."""
    rows: Rows = []
    with TemporaryDirectory() as temporary, one_core():
        for name in names:
            extent = QUICK_FLEX if is_quick else EXTENTS[name]
            rows += own_flex_rows(name, folder or Path(temporary), extent)
    print_table(rows)
    if not is_quick and names == list(EXTENTS):
        write_csv(RESULTS / "large_bodies_own_flex.csv", rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("names", nargs="*")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="of flex, own_flex, fidelity and gradients: little, writes no file",
    )
    parser.add_argument("--folder", type=Path, help="of own_flex: for data and emulators")
    arguments = parser.parse_args()
    print(describe_machine())
    if arguments.part == "own_flex":
        own_flex(arguments.names or list(EXTENTS), arguments.folder, is_quick=arguments.quick)
        return
    arguments.names = arguments.names or list(FAMILIES)
    if arguments.part == "sheet":
        draw_sheet(arguments.names, PICTURE)
        return
    if arguments.part == "gradients":
        extent = QUICK if arguments.quick else THOROUGH
        gradients(arguments.names, extent.paths)
        return
    if arguments.part == "fidelity":
        fidelity(arguments.names, QUICK if arguments.quick else THOROUGH)
        return
    with one_core():
        if arguments.part == "equal_error":
            equal_error(arguments.names)
            return
        if arguments.part == "physics":
            rows = physics_rows()
        else:
            rows = flex_rows(arguments.names, is_quick=arguments.quick)
    print_table(rows)
    if not arguments.quick:
        write_csv(RESULTS / f"large_bodies_{arguments.part}.csv", rows)


if __name__ == "__main__":
    main()
