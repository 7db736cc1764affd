"""Bodies of thousands of nodes; each part writes results/large_bodies_PART.csv.

python benchmarks/large_bodies.py physics                 a cloth in C, by mesh and small steps: time, convergence
python benchmarks/large_bodies.py mesh cloth.obj          the mesh of the cloth of 70 x 70 nodes that the emulator is of; then
    neuroanimator new cloth.obj && neuroanimator train cloth.toml --out cloth.emulator.safetensors
python benchmarks/large_bodies.py emulator cloth.toml cloth.emulator.safetensors
                                                          that emulator beside the physics: error and time

Physics: a cloth of 1 m hangs by its upper edge from a bar that is moved, and a ball of 0.15 m passes through it: 1 s
from rest. Times are of one core in float32: of one cloth, and of one of sixteen side by side. Differences are of all
nodes, root mean square, from the same mesh in the most small steps, and from the finest mesh in as many, at the nodes both have.

Emulator: runs of 1 s along paths of holder and ball that training never saw: smooth ones, as a hand moves things (waves
of at most 0.5 Hz), 2 s after rest, and such random ones as emulators are trained on, 2 s after a random start. The truth
is the teacher's physics with all nodes. Beside the emulator stand the physics started from the state as the emulator
knows it (nodes put together of the shapes), and along smooth paths cheaper physics: fewer small steps, coarser meshes,
whose nodes are interpolated. Errors are of all nodes [% of the cloth's size, root mean square]: mean and 95th
percentile of runs; of normals the mean angle. Times are of one core, one cloth, in float32, interleaved.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import neuroanimator as na
from neuroanimator.data.sampling import sample_control_runs
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.speed import interleaved, one_core
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.systems.soft.mesh_file import Mesh
from neuroanimator.systems.soft.meshes import Cloth, cloth_body
from neuroanimator.systems.soft.obj_file import read_obj
from neuroanimator.systems.soft.program import LANES, SoftProgram
from neuroanimator.systems.soft.scene import Motion, Scene
from neuroanimator.systems.soft.soft_body import Air, Capsule, SoftBody
from neuroanimator.systems.soft.soft_system import SoftSystem
from neuroanimator.terminal import print_table, progress_bar

Rows = list[dict[str, Any]]

RESULTS = Path(__file__).parent / "results"

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

SIDE = 70
"""Number of nodes along an edge of the cloth that is emulated."""

SHOWN = (1, 8, 15, 30)
"""Numbers of super steps after which errors are shown."""

LEAD = 60
"""Number of super steps of physics before a test's run."""

TEST_SEED = 2**31
"""Seed of the test's runs, above any of a dataset's."""

TIMINGS = 5
"""Number of timings of each side; the median counts."""

OPPONENTS = tuple(
    (side, steps)
    for side, several in (
        (70, (80, 40, 20, 10)),
        (35, (40, 20, 10)),
        (24, (20, 10, 5)),
        (15, (10, 5)),
        (10, (5, 3)),
    )
    for steps in several
)
"""Nodes along an edge and small steps a super step of cheaper physics."""


def square(cells: int) -> SoftBody:
    """Return a cloth of 1 m × 1 m in triangles, hung by its upper edge."""
    line = np.linspace(0, 1, cells + 1)
    x, z = np.meshgrid(line - 0.5, -line)
    nodes = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    corners = (nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:])
    a, b, c, d = (corner.ravel() for corner in corners)
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return cloth_body(
        np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1),
        faces,
        Cloth(density=0.2, stretch=20.0, bend=0.5),
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
    program = SoftProgram(body, lanes)
    times = []
    for _ in range(ROUNDS):
        began = time.process_time()
        path, _ = program.play(*parts, FRAME, steps)
        times.append(time.process_time() - began)
    return path[-1], min(times) / FRAMES / lanes * 1e3


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


def mesh_text(side: int) -> str:
    """Return the OBJ file of a cloth of 1 m that hangs along -Z."""
    line = np.linspace(0, 1, side)
    rows = [f"v {x - 0.5:.6f} 0 {1.5 - z:.6f}" for z in line for x in line]
    for first in (np.arange(side - 1)[:, None] * side + np.arange(1, side)).ravel().tolist():
        rows.append(f"f {first} {first + side} {first + side + 1}")
        rows.append(f"f {first} {first + side + 1} {first + 1}")
    return "\n".join(rows) + "\n"


class Test(NamedTuple):
    """Unseen runs, side by side, and the physics of all nodes along them."""

    system: SoftSystem
    paths: np.ndarray
    """(F, D, LANES) positions of movers [m], the start included."""
    given: np.ndarray
    """(D, LANES) their velocities before the start [m/s]."""
    start: Motion
    truth: np.ndarray
    """(F-1, N, 3, LANES) positions of nodes [m]."""
    dt: float


def unseen(system: SoftSystem, dt: float, kind: str) -> Test:
    """Return the test's runs: `FRAMES` super steps after a lead."""
    rng = np.random.default_rng(TEST_SEED)
    if kind == "smooth":
        starts = np.repeat(system.rest[None], LANES, axis=0)
        controls = system.sample_paths(rng, LANES, LEAD + FRAMES, dt)
    else:
        starts = system.sample_starts(rng, LANES)
        controls = sample_control_runs(rng, LANES, LEAD + FRAMES, dt, system)
    changes = np.concatenate([np.zeros_like(controls[:, :1]), controls], axis=1) * dt
    movers = starts[:, None, : system.control.size] + np.cumsum(changes, axis=1)
    paths = np.moveaxis(movers, 0, -1)
    steps = system.truth.steps(dt)
    given_start = system.motion(starts)
    from_world = Motion(given_start.positions + given_start.origin, given_start.velocities)
    before, velocities = system.scene.play(from_world, paths[: LEAD + 1], dt, steps)
    start = Motion(before[-1].copy(), velocities[-1].copy())
    truth, _ = system.scene.play(start, paths[LEAD:], dt, steps)
    given = (paths[LEAD] - paths[LEAD - 1]) / dt
    return Test(system, paths[LEAD:], given, start, truth, dt)


def known_state(test: Test) -> np.ndarray:
    """Return the states (LANES, S) at the test's start, as the emulator knows them."""
    system = test.system
    nodes = [np.moveaxis(part, -1, 0) for part in test.start[:2]]
    return system.encode(*nodes, test.paths[0].T, test.given.T)


def errors_of(test: Test, positions: np.ndarray) -> dict[str, float]:
    """Return the errors of positions (F-1, N, 3, LANES) as columns of a row."""
    distance = np.sqrt(((positions - test.truth) ** 2).sum(axis=2).mean(axis=1)) * 100
    size = test.system.scene.size
    columns: dict[str, float] = {}
    for frame in SHOWN:
        errors = distance[frame - 1] / size
        columns[f"error_{frame}_percent"] = float(errors.mean())
    columns["error_95_percent"] = float(np.quantile(distance[SHOWN[-1] - 1] / size, 0.95))
    faces = test.system.shapes.faces
    normals = [face_normals(path[SHOWN[-1] - 1], faces) for path in (positions, test.truth)]
    cosine = (normals[0] * normals[1]).sum(axis=1).clip(-1, 1)
    columns["normals_degrees"] = float(np.degrees(np.arccos(cosine)).mean())
    return columns


def face_normals(nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return unit normals (F, 3, LANES) of nodes (N, 3, LANES)."""
    a, b, c = (nodes[faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a, axis=1)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def between(side: int, coarse: int) -> np.ndarray:
    """Return the matrix (side, coarse) that interpolates linearly along an edge."""
    fine_line = np.linspace(0, 1, side)
    coarse_line = np.linspace(0, 1, coarse)
    rows = [np.interp(fine_line, coarse_line, unit) for unit in np.eye(coarse)]
    return np.stack(rows, axis=1)


def resampled(grid: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return nodes (..., n*n, 3, LANES) of a square grid at other points of it."""
    side = matrix.shape[1]
    square_grid = grid.reshape(*grid.shape[:-3], side, side, 3, grid.shape[-1])
    moved = np.einsum("ai,bj,...ijkl->...abkl", matrix, matrix, square_grid)
    return moved.reshape(*grid.shape[:-3], -1, 3, grid.shape[-1])


def coarser(definition: SoftDefinition, side: int, coarse: int) -> Scene:
    """Return the same cloth by a mesh of `coarse` nodes along an edge."""
    positions, faces = read_obj("coarse.obj", mesh_text(coarse).encode())
    movers = dict(definition.movers)
    for name, mover in movers.items():
        if mover.pins:
            movers[name] = mover.model_copy(update={"pins": tuple(range(coarse))})
    return Scene(definition.model_copy(update={"movers": movers}), Mesh(positions, faces))


def emulator_rows(toml: Path, file: Path) -> Rows:
    """Return a row for the emulator, and for each way to simulate the same."""
    system = na.load_system(str(toml))
    emulator = na.Emulator.load(file)
    definition = check_table(read_toml(toml), toml.name, SoftDefinition)
    dt = emulator.dt
    rows: Rows = []
    for kind in ("smooth", "random"):
        rows += rows_of(emulator, definition, unseen(system, dt, kind), kind)
    return rows


def rows_of(emulator: na.Emulator, definition: SoftDefinition, test: Test, kind: str) -> Rows:
    """Return the rows of paths of this `kind`; those of other physics along smooth ones alone."""
    system = test.system
    dt = test.dt
    controls = np.moveaxis(np.diff(test.paths, axis=0) / dt, -1, 0)
    states = known_state(test)
    path = np.asarray(emulator.rollout(states.astype(np.float32), controls.astype(np.float32)))
    rows: Rows = []
    players: dict[str, Callable[[], Any]] = {}
    decoded = np.moveaxis(system.shapes.decode(path[:, 1:]), 0, -1)
    rows.append({"what": "emulator"} | errors_of(test, decoded))
    one = (states[0].astype(np.float32), controls[0].astype(np.float32))
    players["emulator"] = lambda: emulator.rollout(*one)
    modes = np.ascontiguousarray(
        system.shapes.modes.reshape(len(system.shapes.modes), -1), np.float32
    )
    shown = path[0, 1:, system.shapes.amplitudes].astype(np.float32)
    rows.append({"what": "emulator, all nodes"} | errors_of(test, decoded))
    players["emulator, all nodes"] = lambda: [
        emulator.rollout(*one),
        *(now @ modes for now in shown),
    ]
    best = np.moveaxis(
        system.shapes.decode(system.simulate(states, controls, dt).states[:, 1:]), 0, -1
    )
    rows.append({"what": "physics from the shapes"} | errors_of(test, best))
    still = np.broadcast_to(test.start.positions, test.truth.shape)
    rows.append({"what": "nothing moves"} | errors_of(test, still))
    side = round(len(system.shapes.mean) ** 0.5)
    for coarse, small_steps in OPPONENTS if kind == "smooth" else ():
        scene = system.scene if coarse == side else coarser(definition, side, coarse)
        down = between(coarse, side)
        start = Motion(*(resampled(np.asarray(part, float), down) for part in test.start[:2]))
        found, _ = scene.play(start, test.paths, dt, small_steps)
        name = f"{coarse} x {coarse} nodes, {small_steps} small steps"
        if not np.isfinite(found).all():
            rows.append({"what": f"{name}: diverges"})
            continue
        whole = resampled(found.astype(float), between(side, coarse))
        rows.append({"what": name} | errors_of(test, whole))
        alone = Motion(*(np.ascontiguousarray(part[..., 0]) for part in start[:2]))
        players[name] = partial(scene.play, alone, test.paths[..., 0], dt, small_steps)
    seconds = interleaved(players, TIMINGS)
    for row in rows:
        if row["what"] in seconds:
            row["us_a_super_step"] = seconds[row["what"]] / FRAMES * 1e6
    own = seconds["emulator"]
    for row in rows:
        if row["what"] in seconds:
            row["times_slower"] = seconds[row["what"]] / own
    columns = [column for column in rows[0] if column != "what"]
    return [
        {"paths": kind, "what": row["what"]} | {column: row.get(column, "") for column in columns}
        for row in rows
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("part", choices=("physics", "mesh", "emulator"))
    parser.add_argument("files", nargs="*", type=Path)
    arguments = parser.parse_args()
    part = arguments.part
    if part == "mesh":
        arguments.files[0].write_text(mesh_text(SIDE))
        return
    with one_core():
        rows = physics_rows() if part == "physics" else emulator_rows(*arguments.files)
    print(describe_machine())
    print_table(rows)
    write_csv(RESULTS / f"large_bodies_{part}.csv", rows)


if __name__ == "__main__":
    main()
