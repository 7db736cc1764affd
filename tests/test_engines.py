"""The examples in other languages are built and run where there is a tool for it; else their syntax is checked."""

from __future__ import annotations

import ctypes
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tree_sitter
import tree_sitter_c_sharp
import tree_sitter_gdscript

from neuroanimator import load_emulator, load_policy, write_wasm
from neuroanimator.export.programs.c_header import c_header
from neuroanimator.export.programs.definition import definition_of

EXAMPLES = Path(__file__).parents[1] / "examples" / "engines"
BUILD = ("gcc", "-O1", "-std=c99", "-Wall", "-Wextra", "-Werror")
LANGUAGES = {"School.cs": tree_sitter_c_sharp, "school.gd": tree_sitter_gdscript}

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no node")

SCHOOL_CHECK = """
import { readFileSync } from "node:fs";
import assert from "node:assert/strict";
import { facts, load as loadFish } from "./fish.js";
import { facts as policyFacts, load as loadPolicy } from "./swim.js";
import { School } from "./school.js";

const fish = await loadFish(readFileSync("fish.wasm"));
const policy = await loadPolicy(readFileSync("swim.wasm"));
const school = new School(fish, policy, facts, policyFacts, 200);
const target = [1, 1];
const distance = () => {
  let sum = 0;
  let count = 0;
  school.forEach((points) => {
    sum += Math.hypot(points[0] - target[0], points[1] - target[1]);
    count += 1;
  });
  assert.equal(count, 200);
  return sum / count;
};
const before = distance();
for (let image = 0; image < 600; image++) school.advance(1 / 60, target);
assert.ok(distance() < before - 0.5, `${before} ${distance()}`);
console.log("they come");
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the examples with the headers they include."""
    copied = tmp_path_factory.mktemp("engines") / "engines"
    shutil.copytree(EXAMPLES, copied)
    for name, model in (("fish", load_emulator("fish-50")), ("swim", load_policy("fish"))):
        text = c_header(model, definition_of(model), name)
        (copied / f"{name}.h").write_text(text, encoding="ascii")
    return copied


def built(folder: Path, source: str, out: str, *options: str) -> Path:
    """Build an example and return what was made."""
    command = [*BUILD, *options, source, "-o", out, "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / out


def constants_in(header: str) -> dict[str, float]:
    """Return the numbers a header defines, by their names."""
    found = re.findall(r"#define (\w+) ([\d.e+-]+)f?\b", header)
    found += re.findall(r"    (\w+) = (\d+),", header)
    return {name: float(number) for name, number in found}


@needs_gcc
def test_a_school_in_c_swims_to_its_places(folder: Path):
    program = built(folder, "school.c", "school")
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    before, after = map(float, re.findall(r"([\d.]+) m to go", said))
    assert before == pytest.approx(1, abs=0.05)
    assert after < 0.3


@needs_gcc
def test_the_server_answers_as_the_policy_and_the_emulator_do(folder: Path):
    program = built(folder, "fish_server.c", "fish_server", "-O0")
    policy = load_policy("fish")
    emulator = policy.emulator
    commands = np.array([[0.1, 0.5, 0, 0], [0.14, -1, 0.2, 0]], np.float32)
    asked = commands.tobytes() * 3
    answer = subprocess.run([program, "2"], input=asked, capture_output=True, check=True).stdout
    states = np.frombuffer(answer, np.float32).reshape(3, 2, emulator.state.size)

    @jax.jit
    def advance(latent: Any, state: Any, phase: Any, command: Any) -> tuple[Any, Any]:
        control = policy.control(emulator.encode(state), phase, command)
        # As in a rollout, bodies go on from their latent states.
        latent = emulator.step_latent(latent, emulator.encode_control(control))
        return latent, emulator.decode(latent)

    for body, command in enumerate(commands):
        state = jnp.asarray(emulator.rest)
        latent = emulator.encode(state)
        for step in range(3):
            phase = jnp.asarray(step * policy.tick)
            latent, state = advance(latent, state, phase, jnp.asarray(command))
            np.testing.assert_allclose(states[step, body], state, atol=1e-4)


@needs_gcc
@pytest.mark.parametrize("words", [[], ["0"], ["many"], ["1000000"]])
def test_the_server_refuses_a_count_that_is_none(words: list[str], folder: Path):
    program = folder / "fish_server"
    if not program.exists():
        built(folder, "fish_server.c", "fish_server", "-O0")
    refused = subprocess.run([program, *words], input="", capture_output=True, text=True)
    assert refused.returncode == 2
    assert "wanted a number of fish from 1 to 100000" in refused.stderr


@needs_gcc
def test_the_library_has_what_c_sharp_calls_and_the_numbers_are_the_headers(folder: Path):
    source = (folder / "School.cs").read_text()
    made = built(folder, "fish_library.c", "libfish.so", "-shared", "-fPIC", "-O0")
    library = ctypes.CDLL(str(made))
    imported = re.findall(r"static extern \w+ (\w+)\(", source)
    assert imported == ["fish_encode", "fish_advance_batch", "swim_control"]
    assert all(hasattr(library, name) for name in imported)
    numbers = constants_in((folder / "fish.h").read_text() + (folder / "swim.h").read_text())
    for name, same in {
        "State": "FISH_STATE",
        "Latent": "FISH_LATENT",
        "Control": "FISH_CONTROL",
        "Nose": "FISH_STATE_NOSE",
        "TailUp": "FISH_STATE_TAIL_UP",
        "PhasePerStep": "SWIM_PHASE_PER_STEP",
    }.items():
        (number,) = re.findall(rf"const \w+ {name} = ([\d.]+)f?;", source)
        assert float(number) == pytest.approx(numbers[same], rel=1e-6), name


def test_the_numbers_in_gdscript_are_the_headers(folder: Path):
    source = (folder / "school.gd").read_text()
    numbers = constants_in((folder / "fish.h").read_text())
    for name, same in {
        "STATE": "FISH_STATE",
        "NOSE": "FISH_STATE_NOSE",
        "TAIL_UP": "FISH_STATE_TAIL_UP",
        "SUPER_STEP": "FISH_DT",
    }.items():
        (number,) = re.findall(rf"const {name} := ([\d.]+)", source)
        assert float(number) == pytest.approx(numbers[same], rel=1e-6), name


@pytest.mark.parametrize("name", LANGUAGES)
def test_what_no_tool_here_runs_is_at_least_well_formed(name: str):
    parser = tree_sitter.Parser(tree_sitter.Language(LANGUAGES[name].language()))
    source = (EXAMPLES / name).read_bytes()
    assert not parser.parse(source).root_node.has_error
    assert parser.parse(source.replace(b"(", b"((", 1)).root_node.has_error


def test_the_page_asks_no_other_host():
    for path in (EXAMPLES / "web").iterdir():
        assert "//" not in re.sub(r"// [^\n]*", "", path.read_text()), path


@needs_node
def test_the_pages_script_is_well_formed(tmp_path: Path):
    page = (EXAMPLES / "web" / "index.html").read_text()
    (script,) = re.findall(r'<script type="module">(.*?)</script>', page, re.DOTALL)
    (tmp_path / "page.mjs").write_text(script)
    (tmp_path / "school.mjs").write_text((EXAMPLES / "web" / "school.js").read_text())
    for name in ("page.mjs", "school.mjs"):
        subprocess.run(["node", "--check", name], cwd=tmp_path, check=True)


@pytest.mark.endurance
@needs_node
def test_the_pages_school_swims_to_its_target(tmp_path: Path):
    web = tmp_path / "web"
    shutil.copytree(EXAMPLES / "web", web)
    write_wasm(load_emulator("fish-50"), web / "fish.wasm")
    write_wasm(load_policy("fish"), web / "swim.wasm")
    (web / "package.json").write_text(json.dumps({"type": "module"}))
    (web / "check.mjs").write_text(SCHOOL_CHECK)
    result = subprocess.run(["node", "check.mjs"], cwd=web, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (0, "they come\n"), result.stderr
