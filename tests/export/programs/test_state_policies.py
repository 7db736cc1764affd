"""A policy of `neuroanimator policy` is a program like any other: C, WebAssembly and ONNX do what it does in JAX."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from test_wasm import needs_node, run_in_node

from neuroanimator import load_emulator
from neuroanimator.control.policies.state_policy import Perceptron, StatePolicy, View
from neuroanimator.export.programs.formats import export_programs

CHECK = """
import { readFileSync } from "node:fs";
import assert from "node:assert/strict";
import { facts, load } from "./walk.js";

const { inputs, outputs, tolerance } = JSON.parse(readFileSync("walk.vectors.json")).control;
const policy = await load(readFileSync("walk.wasm"));
inputs.state.forEach((state, i) => {
  const control = policy.control(state);
  control.forEach((number, j) => assert.ok(Math.abs(number - outputs.control[i][j]) <= tolerance.control[j]));
});
assert.throws(() => policy.control([0]), /state: wanted 6 numbers, got 1/);
console.log(facts.kind);
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy of the pendulum with random weights."""
    emulator = load_emulator("pendulum")
    shown = tuple(range(1, 6))
    view = View(jnp.full(5, 0.1), jnp.full(5, 0.7), shown)
    network = Perceptron.fresh((5, 16, 8, emulator.control.size), jax.random.key(0), 1.0)
    path = tmp_path_factory.mktemp("policy") / "walk.policy.safetensors"
    StatePolicy(emulator, view, network).save(path)
    return path


@pytest.mark.parametrize("ending", [".h", ".onnx"])
def test_programs_do_what_jax_does(ending: str, file: Path, tmp_path: Path):
    (written,) = export_programs(str(file), [tmp_path / f"walk{ending}"], is_policy=False)
    assert written.difference < 1e-4


@needs_node
def test_its_es_module_does_what_jax_does(file: Path, tmp_path: Path):
    export_programs(str(file), [tmp_path / "walk.wasm"], is_policy=False)
    assert run_in_node(CHECK, tmp_path) == "state-policy\n"
