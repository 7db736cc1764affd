"""The physics that the page runs, the cube's and that beside swimmers' emulators, is that of Python."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroanimator import load_emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.programs.wasm_file import WasmModule
from neuroanimator.files.zoo import SHIPPED, SHIPPED_SYSTEMS, SOFT
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.learn.tasks.swimmers import gait_controls
from neuroanimator.physics import load_system
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator_studio.catalogue import (
    PHYSICS_BUNDLES,
    PHYSICS_WASM,
    SHIPPED_BUNDLES,
    shipped_folder,
)
from neuroanimator_studio.drive import checked_drive
from neuroanimator_studio.exports import write_motion
from neuroanimator_studio.judge import replay_physics
from neuroanimator_studio.library import Library
from neuroanimator_studio.limits import USUAL
from neuroanimator_studio.physics import physics_facts
from neuroanimator_studio.requests import Export, Replay

wasmtime = pytest.importorskip("wasmtime")

CUBE = shipped_folder() / "cube"


def facts() -> dict[str, Any]:
    return json.loads((CUBE / "bundle.json").read_text())


def module() -> WasmModule:
    return WasmModule(wasmtime, (CUBE / "emulator.wasm").read_bytes(), "emulator")


def rollout(start: np.ndarray, controls: np.ndarray) -> np.ndarray:
    states = np.zeros((len(controls) + 1, len(start)), np.float32)
    first = np.ascontiguousarray(start, np.float32)
    held = np.ascontiguousarray(controls, np.float32)
    module().call("rollout", first, held, len(held), states)
    return states


def test_every_system_is_on_the_stage():
    with_emulator = {system for system, _ in [*SHIPPED, *SOFT]}
    assert with_emulator | set(PHYSICS_BUNDLES) == set(SHIPPED_SYSTEMS)


def test_the_module_does_what_the_true_physics_does():
    rng = np.random.default_rng(0)
    system = load_system("cube")
    motion = facts()["default_motion"]
    controls = rng.uniform(-1, 1, (100, 3)).astype(np.float32)
    runs = system.simulate_fastest(
        np.array(motion["start"])[None], controls[None].astype(float), facts()["dt"]
    )
    states = rollout(np.array(motion["start"]), controls)
    # Bounces amplify the rounding of a start in float32.
    np.testing.assert_allclose(states, runs.states[0], atol=1e-3)


@pytest.mark.parametrize("name", ["fish-50", "fishes-50", "dolphin-50"])
def test_the_physics_beside_an_emulator_is_the_true_physics(name: str):
    emulator = load_emulator(name)
    system = system_of(emulator)
    beside = WasmModule(wasmtime, (shipped_folder() / name / PHYSICS_WASM).read_bytes(), "physics")
    controls = gait_controls(system, 20, emulator.dt).astype(np.float32)
    start = np.array(system.rest, np.float32)
    for function, scheme in (("rollout", system.truth), ("rollout_usual", system.scheme)):
        states = np.zeros((len(controls) + 1, len(start)), np.float32)
        beside.call(function, start, controls, len(controls), states)
        runs = system.simulate_fastest(
            start[None].astype(float), controls[None].astype(float), emulator.dt, scheme=scheme
        )
        np.testing.assert_allclose(states, runs.states[0], atol=1e-5)


@pytest.mark.parametrize("name", SHIPPED_BUNDLES)
def test_physics_goes_along_where_the_page_can_run_it(name: str):
    folder = shipped_folder() / name
    described = json.loads((folder / "bundle.json").read_text())
    is_soft = isinstance(load_system(described["system"]), DeformableSystem)
    assert described["physics"] == (PHYSICS_WASM if is_soft else None)
    assert (folder / PHYSICS_WASM).is_file() == is_soft


def test_many_cubes_move_as_one_does():
    start = np.array(facts()["default_motion"]["start"], np.float32)
    latents = np.tile(start, (3, 1))
    states = np.zeros_like(latents)
    controls = np.zeros((3, 3), np.float32)
    module().call("advance_batch", latents, controls, 3, states)
    np.testing.assert_array_equal(states, np.tile(rollout(start, controls[:1])[1], (3, 1)))
    np.testing.assert_array_equal(latents, states)


def test_the_cube_is_thrown_bounces_and_comes_to_rest_on_the_ground():
    motion = facts()["default_motion"]
    states = rollout(np.array(motion["start"]), np.array(motion["controls"]))
    heights = states[:, 2:24:3].mean(axis=1)
    lowest = states[:, 2:24:3].min(axis=1)
    assert heights.max() > 0.6
    assert lowest.min() > -0.03
    turning_points = np.diff(np.sign(np.diff(heights)))
    assert (turning_points > 0).sum() >= 2, "it bounces"
    assert np.abs(states[-1, 24:]).max() < 0.2


def test_the_shipped_cube_made_anew_says_the_same():
    again = json.loads(json.dumps(physics_facts("cube", CUBE)))
    shipped = facts()
    assert again.keys() == shipped.keys()
    for name in ("state", "control", "dt", "model", "sha256", "scene", "goals", "default_motion"):
        assert again[name] == shipped[name], name


def test_the_server_replays_and_exports_it(tmp_path):
    shown = Library(tmp_path).load("cube")
    motion = facts()["default_motion"]
    short = {"start": motion["start"], "controls": motion["controls"][:10]}
    wanted = Replay(id=1, do="replay", bundle="cube", **short)
    replayed = replay_physics(shown, checked_drive(shown.spec, wanted, USUAL), USUAL)
    states = rollout(np.array(motion["start"]), np.array(motion["controls"][:10]))
    np.testing.assert_allclose(replayed.states, states, atol=1e-4)
    for kind in ("glb", "csv", "usda"):
        wanted = Export(bundle="cube", format=kind, rate=50, ghost=True, **short)
        write_motion(shown, wanted, USUAL, tmp_path / f"cube.{kind}")
        assert (tmp_path / f"cube.{kind}").stat().st_size > 100


def test_a_motion_that_physics_made_is_exported_as_physics_made_it(tmp_path: Path):
    shown = Library(tmp_path).load("pendulum-passive-50")
    start = [1.0, 0.5, 0.0, 0.0, 0.0, 0.0]
    held = [[0.0, 0.0, 0.0]] * 40
    wanted = Export(
        bundle="pendulum-passive-50",
        format="csv",
        rate=20,
        start=start,
        controls=held,
        source="physics",
    )
    write_motion(shown, wanted, USUAL, tmp_path / "swing.csv")
    written = np.loadtxt(tmp_path / "swing.csv", delimiter=",", skiprows=1)[:, 1:]
    replayed = replay_physics(shown, checked_drive(shown.spec, wanted, USUAL), USUAL)
    np.testing.assert_allclose(written, replayed.states, atol=1e-6)


def test_the_server_pushes_as_the_page_does():
    system = load_system("cube")
    shown = Library(Path()).load("cube")
    start = np.array(facts()["rest"])
    change = np.zeros(system.state.size)
    change[24::3] = 1.5
    held = [[0.0, 0.0, 0.0]] * 12
    pushes = [(5, change.tolist()), (8, (-change).tolist()), (5, change.tolist())]
    wanted = Replay(
        id=1, do="replay", bundle="cube", start=start.tolist(), controls=held, pushes=pushes
    )
    replayed = replay_physics(shown, checked_drive(shown.spec, wanted, USUAL), USUAL)
    before = rollout(start, np.zeros((5, 3)))
    after = rollout(before[-1] + 2 * change, np.zeros((3, 3)))
    last = rollout(after[-1] - change, np.zeros((4, 3)))
    states = np.concatenate([before, after[1:], last[1:]])
    np.testing.assert_allclose(replayed.states, states, atol=1e-4)
    assert np.ptp(states[:, 0]) > 0.15


@pytest.mark.parametrize(
    ("pushes", "line"),
    [
        ([(12, [0.0] * 48)], "wanted super steps below 12, got 12"),
        ([(1, [0.0] * 47)], "pushes"),
    ],
)
def test_a_push_out_of_place_is_refused(pushes: list[tuple[int, list[float]]], line: str):
    shown = Library(Path()).load("cube")
    wanted = Replay(
        id=1,
        do="replay",
        bundle="cube",
        start=facts()["rest"],
        controls=[[0.0, 0.0, 0.0]] * 12,
        pushes=pushes,
    )
    with pytest.raises(ArgumentError, match=line):
        checked_drive(shown.spec, wanted, USUAL)
