"""A WebAssembly module does what its emulator or policy does in JAX, alone and through its ES module."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
import wasmtime
from conftest import Cli
from waiting import PATIENCE

from neuroanimator import Emulator, NeuroAnimatorError, load_emulator, load_policy, write_wasm
from neuroanimator.codegen.wasm import wasm_module
from neuroanimator.errors import ResourceError
from neuroanimator.export.programs import wasm_file
from neuroanimator.export.programs.c_file import check_steps
from neuroanimator.export.programs.definition import definition_of
from neuroanimator.export.programs.vectors import make_vectors
from neuroanimator.files.zoo import SHIPPED

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no node")

EMULATOR_CHECK = """
import { readFileSync } from "node:fs";
import assert from "node:assert/strict";
import { facts, load } from "./lander.js";

const vectors = JSON.parse(readFileSync("lander.vectors.json"));
const emulator = await load(readFileSync("lander.wasm"));
const near = (found, wanted, tolerance) => {
  assert.equal(found.length, wanted.length);
  wanted.forEach((number, i) => assert.ok(Math.abs(found[i] - number) <= tolerance[i], `${i}: ${found[i]} ${number}`));
};

assert.deepEqual(facts, vectors.facts);
near(emulator.rest, facts.rest, facts.rest.map(() => 1e-6));
const { inputs, outputs, tolerance } = vectors.step;
inputs.state.forEach((state, i) => {
  const control = inputs.control[i];
  near(emulator.step(state, control), outputs.next_state[i], tolerance.next_state);
  near(emulator.rollout(state, control).slice(13), outputs.next_state[i], tolerance.next_state);
});
vectors.vjp.inputs.state.forEach((state, i) => {
  const { byState, byControl } = emulator.vjp(state, vectors.vjp.inputs.control[i], vectors.vjp.inputs.cotangent[i]);
  near(byState, vectors.vjp.outputs.by_state[i], vectors.vjp.tolerance.by_state);
  near(byControl, vectors.vjp.outputs.by_control[i], vectors.vjp.tolerance.by_control);
});

// More bodies than the module has memory for at first.
const count = 20001;
const batch = emulator.batch(count);
near(batch.states.subarray(13 * (count - 1)), emulator.rest, facts.rest.map(() => 1e-6));
for (let body = 0; body < count; body++) {
  batch.states.set(inputs.state[body % inputs.state.length], 13 * body);
  batch.controls.set(inputs.control[body % inputs.state.length], 4 * body);
}
batch.encode();
batch.advance();
for (const body of [0, 15, 16, 20000]) {
  const wanted = outputs.next_state[body % inputs.state.length];
  near(batch.states.subarray(13 * body, 13 * (body + 1)), wanted, tolerance.next_state);
}

const off = [0, 0, 0, 0];
assert.equal(emulator.covers(emulator.rest, off), true);
assert.equal(emulator.covers(emulator.rest, [1e9, 0, 0, 0]), false);
assert.throws(() => emulator.step([1, 2], off), /state: wanted 13 numbers, got 2/);
assert.throws(() => emulator.rollout(emulator.rest, [1, 2, 3]), /controls: wanted 0 numbers, got 3/);
assert.throws(() => emulator.batch(0.5), /count: wanted a whole number of 1 or more, got 0.5/);
console.log("all is well");
"""

POLICY_CHECK = """
import { readFileSync } from "node:fs";
import assert from "node:assert/strict";
import { facts, load } from "./swim.js";

const { inputs, outputs, tolerance } = JSON.parse(readFileSync("swim.vectors.json")).control;
const policy = await load(readFileSync("swim.wasm"));
inputs.state.forEach((state, i) => {
  const control = policy.control(state, inputs.phase[i][0], inputs.command[i]);
  control.forEach((number, j) => assert.ok(Math.abs(number - outputs.control[i][j]) <= tolerance.control[j]));
});
assert.ok(facts.phase_per_step > 0);
assert.throws(() => policy.control(facts.rest, 0, [0]), /command: wanted 4 numbers, got 1/);
console.log("all is well");
"""


@pytest.fixture(scope="module")
def lander(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the module of the lander."""
    folder = tmp_path_factory.mktemp("wasm")
    write_wasm(load_emulator("lander-50"), folder / "lander.wasm", "Apache-2.0")
    return folder


def run_in_node(script: str, folder: Path) -> str:
    """Run an ES module in `folder` and return what it prints."""
    (folder / "check.mjs").write_text(script)
    (folder / "package.json").write_text('{"type": "module"}')
    command = ["node", "check.mjs"]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=PATIENCE)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_a_module_imports_nothing_and_exports_what_it_says(lander: Path):
    module = wasmtime.Module(wasmtime.Engine(), (lander / "lander.wasm").read_bytes())
    assert not module.imports
    names = {export.name for export in module.exports}
    functions = {f"lander_{name}" for name in wasm_file.FUNCTIONS["emulator"]}
    numbers = {f"lander_{name}" for name in wasm_file.NUMBERS}
    assert names == functions | numbers | {"memory", "__heap_base"}
    files = {path.name for path in lander.iterdir()}
    assert {"lander.wasm", "lander.js", "lander.d.ts", "lander.vectors.json"} <= files


@needs_node
def test_the_es_module_of_an_emulator_does_what_jax_does(lander: Path):
    assert run_in_node(EMULATOR_CHECK, lander) == "all is well\n"


@needs_node
def test_the_es_module_of_a_policy_does_what_jax_does(tmp_path: Path):
    write_wasm(load_policy("fish"), tmp_path / "swim.wasm")
    assert run_in_node(POLICY_CHECK, tmp_path) == "all is well\n"


def test_types_name_what_the_es_module_has(lander: Path):
    script = (lander / "lander.js").read_text()
    types = (lander / "lander.d.ts").read_text()
    assert "@" not in script + types
    facts = json.loads(script.partition("export const facts = ")[2].partition(";\n")[0])
    for name in (*facts, "load", "rest", "step", "rollout", "vjp", "covers", "batch", "encode", "advance"):  # fmt: skip
        assert f" {name}" in types, name
        assert f"{name}" in script, name
    assert facts["licence"] == "Apache-2.0"


def test_a_module_that_does_something_else_is_refused(lander: Path):
    emulator = load_emulator("lander-50")
    weaker = jax.tree.map(lambda leaf: 0.9 * leaf, emulator.network)
    emulator = replace(emulator, network=weaker)
    module = wasm_file.WasmModule(wasmtime, (lander / "lander.wasm").read_bytes(), "lander")
    with pytest.raises(NeuroAnimatorError, match="disagrees with JAX"):
        check_steps(module.call, make_vectors(definition_of(emulator), emulator))


def test_the_stack_comes_first_so_that_what_outgrows_it_leaves_the_memory_and_traps(lander: Path):
    store = wasmtime.Store()
    module = wasmtime.Module(store.engine, (lander / "lander.wasm").read_bytes())
    exports = wasmtime.Instance(store, module, []).exports(store)
    assert exports["lander_rest"].value(store) >= 4 << 20


def test_without_its_tools_nothing_is_written(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ResourceError, match=r"Zig compiler. Install it with: pip install 'neuro"):
        write_wasm(load_emulator("pendulum-50"), tmp_path / "p.wasm")
    assert not list(tmp_path.iterdir())


@pytest.mark.endurance
@pytest.mark.parametrize("system", sorted({system for system, _ in SHIPPED}))
def test_every_system_can_be_a_module(system: str, tmp_path: Path):
    written = write_wasm(load_emulator(system), tmp_path / "it.wasm")
    assert written.difference < 1e-3
    assert np.all([path.is_file() for path in written.others])


@pytest.mark.endurance
def test_an_emulator_of_a_body_that_is_pushed_can_be_a_module(
    untrained_cube: Emulator, tmp_path: Path
):
    assert write_wasm(untrained_cube, tmp_path / "it.wasm").difference < 1e-3


@pytest.mark.endurance
@pytest.mark.parametrize("call", ["powf(x, 3.0f)", "fmodf(x, 3.0f)"])
def test_what_no_instruction_computes_comes_from_a_library(call: str):
    text = f"#include <math.h>\nfloat x_computed(float x) {{ return {call}; }}"
    runtime = wasmtime.Store()
    module = wasmtime.Module(runtime.engine, wasm_module(text, "x", ["computed"]))
    computed = wasmtime.Instance(runtime, module, []).exports(runtime)["x_computed"]
    assert computed(runtime, 2.0) == {"powf(x, 3.0f)": 8.0, "fmodf(x, 3.0f)": 2.0}[call]
