"""What the page can look for is found in Python, too, and a person would call it success."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import wasmtime

from neuroanimator import load_emulator
from neuroanimator.control.descent.descend import evaluator_of
from neuroanimator.control.descent.methods import METHODS
from neuroanimator.control.objective.goals import goal_state
from neuroanimator.errors import ArgumentError, NeuroAnimatorError
from neuroanimator.export.programs.wasm_file import WasmModule
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator_studio.catalogue import shipped_folder
from neuroanimator_studio.descent_module import PageDescent, check_module
from neuroanimator_studio.descents import BAY, DESCENT_FILE, WITH_DESCENT, descent_of, judge_motion


def some_bundles(*quick: str) -> list[Any]:
    """Return the names of all bundles with a descent; those not named here are left to `make endurance`."""
    return [
        name if name in quick else pytest.param(name, marks=pytest.mark.endurance)
        for name in WITH_DESCENT
    ]


def made(name: str) -> PageDescent:
    emulator = load_emulator(name)
    descent = descent_of(emulator, system_of(emulator))
    assert descent is not None
    return descent


@pytest.mark.parametrize("name", some_bundles("pendulum-50", "fish-50"))
def test_the_descent_of_every_bundle_finds_what_the_emulator_calls_success(name: str):
    descent = made(name)
    emulator = descent.problem.emulator
    evaluator = evaluator_of(descent.problem)
    method = METHODS["gauss-newton"]
    starts = [method.begin(guess) for guess in descent.guesses]
    for _ in range(descent.facts()["settings"]["iterations"]):
        starts = [start if start.is_done else method.iterate(evaluator, [start])[0] for start in starts]  # fmt: skip
    best = min(starts, key=lambda start: start.least)
    states = np.asarray(evaluator.motion(best.best).states)
    values = {movable.name: movable.value for movable in descent.movable}
    assert judge_motion(emulator, system_of(emulator), values, states).is_success


@pytest.mark.parametrize("name", some_bundles("pendulum-50"))
def test_a_shipped_module_computes_what_python_does(name: str):
    content = (shipped_folder() / name / DESCENT_FILE).read_bytes()
    assert not wasmtime.Module(wasmtime.Engine(), content).imports
    check_module(WasmModule(wasmtime, content, "descent"), made(name))


def test_a_module_that_computes_something_else_is_refused():
    content = (shipped_folder() / "pendulum-50" / DESCENT_FILE).read_bytes()
    descent = made("pendulum-50")
    parametrisation = descent.problem.parametrisation
    weaker = replace(parametrisation, half=0.9 * parametrisation.half)
    other = replace(descent, problem=replace(descent.problem, parametrisation=weaker))
    with pytest.raises(NeuroAnimatorError, match="other numbers than in Python"):
        check_module(WasmModule(wasmtime, content, "descent"), other)


def test_a_truck_that_stays_out_of_its_bay_is_not_parked_and_one_in_it_is():
    emulator = load_emulator("truck-50")
    system = system_of(emulator)
    steps = made("truck-50").problem.parametrisation.steps
    away = np.tile(np.asarray(system.rest, float), (steps + 1, 1))
    verdict = judge_motion(emulator, system, {}, away)
    assert not verdict.is_success
    assert verdict.gap == pytest.approx(7.3)
    there = np.tile(goal_state(system, system.goals[BAY]), (steps + 1, 1))
    assert judge_motion(emulator, system, {}, there).is_success
    # The same place is off where the bay was turned round.
    assert not judge_motion(emulator, system, {"heading": [np.pi / 2]}, there).is_success


def test_a_landing_is_judged_by_where_the_pad_was_dragged_to():
    emulator = load_emulator("lander-50")
    system = system_of(emulator)
    steps = made("lander-50").problem.parametrisation.steps
    standing = np.tile(np.asarray(system.rest, float), (steps + 1, 1))
    standing[:, 2] -= 0.01
    assert judge_motion(emulator, system, {}, standing).is_success
    assert not judge_motion(emulator, system, {"place": [3.0, 0.0, 1.95]}, standing).is_success


def test_a_motion_of_another_length_and_unknown_values_are_refused():
    emulator = load_emulator("pendulum-50")
    system = system_of(emulator)
    states = np.zeros((41, 6))
    with pytest.raises(ArgumentError, match="wanted 41 rows, got 3"):
        judge_motion(emulator, system, {}, states[:3])
    with pytest.raises(ArgumentError, match="values: wanted effort, got weight"):
        judge_motion(emulator, system, {"weight": [1.0]}, states)


def test_what_the_page_is_held_against_is_what_python_finds():
    folder = Path(__file__).parents[2] / "studio" / "tests" / "vectors"
    writer = runpy.run_path(str(folder / "write_descents.py"))
    cases = json.loads((folder / "descents.json").read_text())
    assert {case["bundle"] for case in cases} == set(WITH_DESCENT)
    for case in cases:
        if case["bundle"] == "fish-50":
            costs = writer["costs_of"](made("fish-50"), case["values"])
            np.testing.assert_allclose(costs[:4], case["costs"][:4], rtol=0.03)


def test_the_verdicts_the_page_is_held_against_are_those_of_python():
    folder = Path(__file__).parents[2] / "studio" / "tests" / "vectors"
    writer = runpy.run_path(str(folder / "write_verdicts.py"))
    cases = json.loads((folder / "verdicts.json").read_text())
    assert {case["bundle"] for case in cases} == set(writer["SWIMMERS"])
    assert {case["is_success"] for case in cases} == {True, False}
    for case in cases:
        verdict = writer["verdict_on"](load_emulator(case["bundle"]), case)
        assert (verdict.is_success, verdict.words) == (case["is_success"], case["words"])
