"""An emulator of a soft body that ships beside cheaper physics: errors of all nodes, and time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

import neuroanimator as na
from benchmarks.soft_bodies.families import FAMILIES, Family, resampled
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.learn.evaluation.speed import interleaved
from neuroanimator.physics.soft.program import LANES, MuscleMotion
from neuroanimator.physics.soft.scene import Motion, Scene
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.state.mover_poses import change_between
from neuroanimator.state.parameters import draw_parameters
from neuroanimator.terminal import progress_bar

Rows = list[dict[str, Any]]

ASSETS = Path(na.__file__).parent / "systems" / "assets"

SHOWN = (8, 15, 30)
"""Numbers of super steps after which errors are shown: about 0.25, 0.5 and 1 s."""

STEPS = SHOWN[-1]
"""Number of super steps of a run."""

TEST_SEED = 2**31
"""Seed of the runs, above any of a dataset's."""

TIMINGS = 7
"""Number of timings of each side; the median counts."""

EMULATOR = "emulator"
DECODED = "emulator, all nodes"


class Test(NamedTuple):
    """Unseen runs, side by side, and the physics of all nodes along them."""

    system: SoftSystem
    dt: float
    """Super step [s]."""
    paths: Float[np.ndarray, "F D L"]
    """Poses of movers, the start included."""
    given: Float[np.ndarray, "R L"]
    """Their rates before the start."""
    parameters: Float[np.ndarray, "Q L"]
    """Those of each run, random."""
    start: Motion
    truth: Float[np.ndarray, "T N 3 L"]
    """Positions of nodes [m]."""
    end: Motion
    muscles: MuscleMotion
    """Activations at the start and controls of muscles."""


def shipped(name: str) -> tuple[SoftSystem, na.Emulator]:
    """Return a body that ships and its emulator."""
    system = na.load_system(name)
    assert isinstance(system, SoftSystem)
    return system, na.load_emulator(name)


def unseen(
    system: SoftSystem,
    dt: float,
    lead: int = 60,
    length: int = STEPS,
    *,
    by_reference: bool = False,
) -> Test:
    """Return `LANES` runs of `length` super steps along smooth random paths, by the teacher's physics, `lead` after rest.

    If `by_reference`, the runs are by the finer steps of the reference, the lead by the teacher's.
    """
    rng = np.random.default_rng(TEST_SEED)
    starts = np.repeat(system.rest[None], LANES, axis=0)
    starts[:, system.parameter_entries] = draw_parameters(system.parameters, rng, LANES)
    parameters = starts[:, system.parameter_entries].T
    controls = system.sample_paths(rng, LANES, lead + length, dt)
    movers = system.scene.movers
    muscles = controls[..., movers.rate_size :]
    poses = movers.paths(starts[:, : movers.size], controls[..., : movers.rate_size], dt)
    paths = np.moveaxis(poses, 0, -1)
    steps = system.truth.steps(dt)
    rest = system.motion(starts)
    at_rest = Motion(rest.positions + rest.origin, rest.velocities)
    play = system.scene.play
    idle = starts[:, system.activations]
    first, followed = system.scene.contracted(idle, muscles[:, :lead], dt)
    driven, _ = system.scene.contracted(followed[:, -1], muscles[:, lead:], dt)
    before, velocities = play(at_rest, paths[: lead + 1], dt, steps, parameters, first)
    start = Motion(before[-1].copy(), velocities[-1].copy())
    if by_reference:
        steps = system.fine.steps(dt)
    truth, velocities = play(start, paths[lead:], dt, steps, parameters, driven)
    end = Motion(truth[-1].copy(), velocities[-1].copy())
    given = change_between(paths[lead - 1].T, paths[lead].T, movers.quaternions).T / dt
    return Test(system, dt, paths[lead:], given, parameters, start, truth, end, driven)


def known_states(test: Test) -> Float[np.ndarray, "L S"]:
    """Return the states at the test's start, as the emulator knows them."""
    positions = np.moveaxis(test.start.positions, -1, 0)
    velocities = np.moveaxis(test.start.velocities, -1, 0)
    moving = (positions, velocities, test.paths[0].T, test.given.T)
    active = test.muscles.activations.T
    return test.system.encode(*moving, parameters=test.parameters.T, activations=active)


def controls_of(test: Test) -> Float[np.ndarray, "L T C"]:
    """Return the controls that move the movers along the test's paths, and those of the muscles."""
    poses = np.moveaxis(test.paths, -1, 0)
    quaternions = test.system.scene.movers.quaternions
    rates = change_between(poses[:, :-1], poses[:, 1:], quaternions) / test.dt
    return np.concatenate([rates, np.moveaxis(test.muscles.controls, -1, 0)], axis=2)


def emulated_states(emulator: na.Emulator, test: Test) -> Float[np.ndarray, "L F S"]:
    """Return the emulator's states along the test's paths, the start included."""
    states = known_states(test).astype(np.float32)
    return np.asarray(emulator.rollout(states, controls_of(test).astype(np.float32)), float)


def decoded(system: SoftSystem, states: Float[np.ndarray, "L T S"]) -> Float[np.ndarray, "T N 3 L"]:
    """Return the nodes of runs of states, as `Test.truth` holds them [m]."""
    return np.moveaxis(system.shapes.decode(states), 0, -1)


def errors_of(test: Test, positions: Float[np.ndarray, "T N 3 L"]) -> dict[str, float]:
    """Return the errors of all nodes [% of the size, root mean square] and of normals [degrees] as columns of a row."""
    squares = ((positions - test.truth) ** 2).sum(axis=2).mean(axis=1)
    share = 100 * np.sqrt(squares) / test.system.scene.size
    columns = {f"error_{step}_percent": float(share[step - 1].mean()) for step in SHOWN}
    columns["error_95_percent"] = float(np.quantile(share[-1], 0.95))
    faces = test.system.shapes.faces
    normals = [face_normals(path[-1], faces) for path in (positions, test.truth)]
    cosine = (normals[0] * normals[1]).sum(axis=1).clip(-1, 1)
    columns["normals_degrees"] = float(np.degrees(np.arccos(cosine)).mean())
    return columns


def face_normals(
    nodes: Float[np.ndarray, "N 3 L"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "F 3 L"]:
    """Return unit normals of faces."""
    a, b, c = (nodes[faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a, axis=1)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


class Race:
    """Rows of errors, and what is timed for them."""

    def __init__(self, test: Test, emulator: na.Emulator):
        self.test = test
        self.emulator = emulator
        self.rows: Rows = []
        self.players: dict[str, Callable[[], Any]] = {}

    def add(
        self,
        what: str,
        positions: Float[np.ndarray, "T N 3 L"],
        play: Callable[[], Any] | None = None,
    ) -> None:
        """Add a row for nodes at `positions`; `play` makes one of these runs."""
        self.rows.append({"what": what} | errors_of(self.test, positions))
        if play is not None:
            self.players[what] = play

    def timed(self) -> Rows:
        """Return the rows with the time of a super step [µs], all timed in turn."""
        seconds = interleaved(self.players, TIMINGS)
        for row in self.rows:
            if row["what"] in seconds:
                row["us_a_super_step"] = seconds[row["what"]] / STEPS * 1e6
        return self.rows


def add_emulator(race: Race) -> None:
    """Add the emulator, without and with all nodes, and what it may be compared with."""
    test = race.test
    system = test.system
    emulator = race.emulator
    states = known_states(test)
    controls = controls_of(test)
    path = emulated_states(emulator, test)
    nodes = decoded(system, path[:, 1:])
    first = tuple(part[0] for part in (states.astype(np.float32), controls.astype(np.float32)))
    race.add(EMULATOR, nodes, lambda: emulator.rollout(*first))
    count = len(system.shapes.modes)
    modes = np.ascontiguousarray(system.shapes.modes.reshape(count, -1), np.float32)

    def with_nodes() -> list[np.ndarray]:
        rolled = np.asarray(emulator.rollout(*first))
        return [amplitudes @ modes for amplitudes in rolled[1:, system.shapes.amplitudes]]

    race.add(DECODED, nodes, with_nodes)
    simulated = system.simulate(states, controls, test.dt).states[:, 1:]
    race.add("physics from the shapes", decoded(system, simulated))
    frozen = path[:, 1:].copy()
    frozen[..., system.shapes.amplitudes] = states[:, None, system.shapes.amplitudes]
    race.add("shape as at the start", decoded(system, frozen))


def add_physics(race: Race, name: str, family: Family, definition: SoftDefinition) -> None:
    """Add the physics of fewer nodes, and of fewer small steps."""
    test = race.test
    with progress_bar(name, sum(len(steps) for _, steps in family.opponents)) as bar:
        done = 0
        for share, several in family.opponents:
            shape = family.shape_at(share)
            scene = _scene_of(test, family, definition, shape)
            for steps in several:
                done += 1
                if scene is not None:
                    _add_one(race, family, scene, shape, steps)
                bar.advance_to(done)


def _scene_of(
    test: Test, family: Family, definition: SoftDefinition, shape: tuple[int, ...]
) -> Scene | None:
    """Return the physics on this grid; None where nodes of a coarse one begin inside a collider."""
    try:
        scene = family.scene(definition, shape)
    except ArgumentError:
        return None
    scene.precision = np.float32
    return scene


def _add_one(race: Race, family: Family, scene: Scene, shape: tuple[int, ...], steps: int) -> None:
    test = race.test
    parts = [np.asarray(part, float) for part in test.start[:2]]
    start = Motion(*(resampled(part, family.shape, shape) for part in parts))
    dt = test.dt
    found, _ = scene.play(start, test.paths, dt, steps, test.parameters, test.muscles)
    what = f"{' x '.join(map(str, shape))} nodes, {steps} small steps"
    if not np.isfinite(found).all():
        race.rows.append({"what": f"{what}: diverges"})
        return
    alone = Motion(*(np.ascontiguousarray(part[..., 0]) for part in start[:2]))
    driven = MuscleMotion(*(np.ascontiguousarray(part[..., 0]) for part in test.muscles))
    play = partial(scene.play, alone, test.paths[..., 0], dt, steps, None, driven)
    race.add(what, resampled(found.astype(float), shape, family.shape), play)


def equal_error_rows(name: str, *, by_reference: bool = False) -> tuple[Rows, Rows]:
    """Return (a row for each way to simulate the body, the factors at equal error after each of `SHOWN`).

    Errors are from the teacher's physics, or `by_reference` from finer steps.
    """
    return raced(name, *shipped(name), FAMILIES[name], by_reference=by_reference)


def raced(
    name: str,
    system: SoftSystem,
    emulator: na.Emulator,
    family: Family,
    *,
    by_reference: bool = False,
) -> tuple[Rows, Rows]:
    """Return the rows of `equal_error_rows` for an emulator of the body `name` in a mesh of this family."""
    test = unseen(system, emulator.dt, by_reference=by_reference)
    definition = check_table(read_toml(ASSETS / f"{name}.toml"), name, SoftDefinition)
    race = Race(test, emulator)
    add_emulator(race)
    add_physics(race, name, family, definition)
    rows = race.timed()
    columns = ["body", "what"]
    columns += [key for key in rows[0] if key != "what"]
    told = f"{name}, from the reference" if by_reference else name
    whole = [{column: ({"body": told} | row).get(column, "") for column in columns} for row in rows]
    return whole, factors(told, rows)


def factors(name: str, rows: Rows) -> Rows:
    """Return, after each of `SHOWN`, the cheapest physics that is as exact as the emulator, and how much dearer it is."""
    own = {row["what"]: row for row in rows}
    latent = own[EMULATOR]["us_a_super_step"]
    with_nodes = own[DECODED]["us_a_super_step"]
    physics = [row for row in rows if "small steps" in row["what"] and "us_a_super_step" in row]
    finest = max(physics, key=lambda row: row["us_a_super_step"])
    found = []
    for step in SHOWN:
        column = f"error_{step}_percent"
        error = own[EMULATOR][column]
        as_exact = [row for row in physics if row[column] <= error]
        best = min(as_exact or [finest], key=lambda row: row["us_a_super_step"])
        found.append(
            {
                "body": name,
                "super_steps": step,
                "error_percent": error,
                "as_exact": best["what"],
                "its_error_percent": best[column],
                "times_faster": best["us_a_super_step"] / latent,
                "with_all_nodes": best["us_a_super_step"] / with_nodes,
            }
        )
    return found
