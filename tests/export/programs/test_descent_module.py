"""A descent in WebAssembly has the J, the derivatives and the motion of the descent in Python, wherever its numbers are moved."""

from __future__ import annotations

import numpy as np
import pytest
import wasmtime

import neuroanimator as na
from neuroanimator.control.descent.descend import evaluator_of, pose_problem
from neuroanimator.control.descent.parametrisation import Spline
from neuroanimator.export.programs.wasm_file import WasmModule
from neuroanimator_studio.descent_module import (
    Movable,
    PageDescent,
    Write,
    check_module,
    descent_module,
    entries_of,
)

STEPS = 6


def reaching() -> PageDescent:
    """Return a lander's descent to a place that may be moved, and under an angle, with effort that may be weighed."""
    system = na.load_system("lander")
    emulator = na.load_emulator("lander-50")
    objective = na.Objective.of(na.effort(0.05), na.goal(system, "pad"), na.stay_upright(system))
    goal = entries_of(objective, lambda one: one.terms[1].goal)
    weight = entries_of(objective, lambda one: one.terms[0].weight)
    x, y, z = system.rest[:3]
    place = tuple(Write(int(goal[axis]), axis) for axis in range(3))
    facing = (Write(int(goal[3]), 0), Write(int(goal[6]), 1))
    movable = (
        Movable("place", "place", "m", (x, y, z), (x - 2, y - 2, z), (x + 2, y + 2, z + 1), place),
        Movable("heading", "heading", "rad", (0.0,), (-1.0,), (1.0,), facing),
        Movable("effort", "number", "", (0.05,), (0.01,), (1.0,), (Write(int(weight), 0),)),
    )
    start = np.array(system.rest) + np.eye(13)[2] * 5.0
    parametrisation = Spline.of(STEPS, 4, emulator.bounds)
    problem = pose_problem(emulator, objective, parametrisation, start)
    guesses = np.zeros((1, parametrisation.size))
    return PageDescent("pad", "Lands.", problem, guesses, movable)


@pytest.fixture(scope="module")
def descent() -> PageDescent:
    return reaching()


@pytest.mark.endurance
def test_a_module_made_anew_imports_nothing_and_computes_what_python_does(descent: PageDescent):
    made = descent_module(descent)
    assert not wasmtime.Module(wasmtime.Engine(), made).imports
    check_module(WasmModule(wasmtime, made, "descent"), descent)


def test_facts_of_a_descent_say_how_large_all_is(descent: PageDescent):
    facts = descent.facts()
    assert facts["steps"] == STEPS
    assert facts["z"] == len(facts["guesses"][0])
    assert [movable["name"] for movable in facts["movable"]] == ["place", "heading", "effort"]


def test_moving_a_target_is_stating_another_problem(descent: PageDescent):
    evaluator = evaluator_of(descent.moved({"place": [1.0, 2.0, 3.0], "heading": [np.pi / 2]}))
    goal = descent.moved({"place": [1.0, 2.0, 3.0], "heading": [np.pi / 2]}).objective.terms[1].goal
    np.testing.assert_allclose(goal[:3], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(goal[3:7], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-6)
    z = np.zeros((1, descent.guesses.shape[1]))
    assert evaluator.costs(z) != evaluator_of(descent.problem).costs(z)
    assert evaluator_of(descent.moved({})).costs(z) == evaluator_of(descent.problem).costs(z)
