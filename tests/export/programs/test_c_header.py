"""A C header does what its emulator or policy does in JAX, compiles everywhere without a warning, or is not written."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from conftest import Cli

from neuroanimator import (
    Emulator,
    NeuroAnimatorError,
    load_emulator,
    load_policy,
    write_c_header,
)
from neuroanimator.codegen import compiler
from neuroanimator.codegen.c_function import c_function
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.codegen.trace import Input
from neuroanimator.errors import ResourceError
from neuroanimator.export.programs.c_file import check_gradients, check_steps, compiled_header
from neuroanimator.export.programs.c_header import (
    SharedConstants,
    c_header,
    identifier,
    part_names,
    stored_latent_size,
)
from neuroanimator.export.programs.definition import definition_of
from neuroanimator.export.programs.vectors import (
    KEPT,
    make_gradient_vectors,
    make_vectors,
)
from neuroanimator.files.zoo import POLICIES, SHIPPED
from neuroanimator.state.layout import Layout, Slice

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
WARNINGS = ("-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror")

STANDARDS = ("c99", "c11", "c++11", "c++14", "c++17", "c++20")

ZIG = [sys.executable, "-m", "ziglang", "cc"]

COMPILERS: dict[str, list[str]] = {
    "gcc without vectors, as MSVC has none": ["gcc", "-std=c99", "-DNA_PLAIN"],
    "gcc with wide vectors": ["gcc", "-std=c99", "-mavx512f"],
    "g++ with vectors of AVX": ["g++", "-x", "c++", "-std=c++20", "-mavx2"],
    "gcc with arrays of the thread": ["gcc", "-std=c11", "-DNA_SCRATCH=static _Thread_local"],
    "g++ with arrays of the thread": ["g++", "-x", "c++", "-std=c++11", "-DNA_SCRATCH=static thread_local"],
    "zig": [*ZIG, "-std=c99"],
}  # fmt: skip
for language, commands in (("c", ("gcc", "clang")), ("c++", ("g++", "clang++"))):
    for command in commands:
        for standard in STANDARDS:
            if ("++" in standard) == ("++" in language):
                COMPILERS[f"{command} {standard}"] = [command, "-x", language, f"-std={standard}"]


QUICK = (
    "gcc without vectors, as MSVC has none",
    "gcc with wide vectors",
    "g++ with vectors of AVX",
    "gcc c99",
    "g++ c++11",
    "clang c11",
    "clang++ c++20",
)
"""Every compiler and every width of vectors; the other standards are left to `make endurance`."""


def compilers() -> list[Any]:
    """Return the names of all compilers; those that are not quick run in `make endurance`."""
    return [
        name if name in QUICK else pytest.param(name, marks=pytest.mark.endurance)
        for name in COMPILERS
    ]


def has(command: list[str]) -> bool:
    """Return whether the machine has this compiler."""
    if "ziglang" in command:
        return importlib.util.find_spec("ziglang") is not None
    return shutil.which(command[0]) is not None


@pytest.fixture(scope="module")
def lander(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The header of the lander, whose state has a quaternion."""
    path = tmp_path_factory.mktemp("header") / "lander.h"
    write_c_header(load_emulator("lander-50"), path, "Apache-2.0")
    return path


@needs_compiler
@pytest.mark.parametrize("name", compilers())
def test_every_compiler_takes_it_without_a_warning(name: str, lander: Path, tmp_path: Path):
    command = COMPILERS[name]
    if not has(command):
        pytest.skip(f"no {command[0]}")
    source = tmp_path / "lander.c"
    source.write_text(f'#define LANDER_IMPLEMENTATION\n#include "{lander}"\n')
    made = [*command, *WARNINGS, "-c", str(source), "-o", str(tmp_path / "lander.o")]
    result = subprocess.run(made, capture_output=True, text=True, cwd=tmp_path)
    if "-mavx" in " ".join(command) and "unrecognized" in result.stderr:
        pytest.skip("another processor")
    assert (result.returncode, result.stderr) == (0, "")


def test_some_compiler_reads_headers():
    assert any(map(has, COMPILERS.values())), "no compiler: nothing was tried"


@pytest.mark.endurance
@needs_compiler
@pytest.mark.parametrize("name", ["cape-40", "fish-50", "truck-50", "fish policy"])
@pytest.mark.parametrize("compiler", ["gcc c99", "g++ c++11", "clang c11", "clang++ c++20"])
def test_no_model_is_warned_about(compiler: str, name: str, tmp_path: Path):
    command = COMPILERS[compiler]
    if not has(command):
        pytest.skip(f"no {command[0]}")
    model = load_policy("fish") if "policy" in name else load_emulator(name)
    text = c_header(model, definition_of(model), "it")
    (tmp_path / "it.h").write_text(f"#define IT_IMPLEMENTATION\n{text}")
    (tmp_path / "it.c").write_text('#include "it.h"\n')
    made = [*command, *WARNINGS, "-c", "it.c", "-o", "it.o"]
    result = subprocess.run(made, capture_output=True, text=True, cwd=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")


@needs_compiler
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
def test_the_head_says_what_the_stack_must_hold(lander: Path, tmp_path: Path):
    (tmp_path / "use.c").write_text(f'#define LANDER_IMPLEMENTATION\n#include "{lander}"\n')
    told = lander.read_text().partition("*/")[0]
    batch, single = map(int, re.findall(r"(\d+) kB", told))
    assert batch < 35
    for scratch, room in (("", 1000 * batch), ("-DNA_SCRATCH=static _Thread_local", 1000 * single)):
        made = [
            "gcc",
            "-O1",
            *scratch.split(maxsplit=0),
            "-fstack-usage",
            "-c",
            "use.c",
            "-o",
            "use.o",
        ]
        subprocess.run(made, cwd=tmp_path, check=True)
        usage = (tmp_path / "use.su").read_text().splitlines()
        sizes = {line.split("\t")[0].split(":")[-1]: int(line.split("\t")[1]) for line in usage}
        called = [
            sizes[f"lander_{name}"]
            for name in ("super_step_lanes", "advance_lanes", "step_batch")
            if f"lander_{name}" in sizes
        ]
        assert sum(called) <= room
        assert max(sizes.values()) <= room


@needs_compiler
def test_two_headers_go_into_one_file_and_functions_are_declared_in_others(
    lander: Path, tmp_path: Path
):
    policy = load_policy("fish")
    (tmp_path / "swim.h").write_text(c_header(policy, definition_of(policy), "swim"))
    (tmp_path / "both.c").write_text(
        "#define LANDER_IMPLEMENTATION\n#define SWIM_IMPLEMENTATION\n#define LANDER_WITHOUT_VJP\n"
        f'#include "{lander}"\n#include "swim.h"\n'
    )
    (tmp_path / "main.c").write_text(
        f'#include "{lander}"\n#include "swim.h"\n#include <stdio.h>\n'
        "int main(void) {\n"
        "    float state[LANDER_STATE], body[SWIM_STATE], control[SWIM_CONTROL];\n"
        "    const float command[4] = {0.1f};\n"
        "    lander_step(lander_rest, lander_control_high, state);\n"
        "    for (int i = 0; i < SWIM_STATE; i++) body[i] = swim_rest[i];\n"
        "    swim_control(body, 0.5f, command, control);\n"
        '    printf("%.9g %.9g", state[LANDER_STATE_ROOT_VELOCITY + 2], control[0]);\n'
        "    return 0;\n}\n"
    )
    build = ["gcc", *WARNINGS, "main.c", "both.c", "-o", "main", "-lm"]
    subprocess.run(build, cwd=tmp_path, check=True)
    said = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    rising, muscle = map(float, said.split())

    emulator = load_emulator("lander-50")
    state = emulator.step(emulator.rest, np.array(emulator.bounds.high))
    expected = emulator.state.part(np.asarray(state), "root.velocity")[2]
    assert rising == pytest.approx(expected, rel=1e-4)
    latent = policy.emulator.encode(jnp.asarray(policy.emulator.rest))
    control = policy.control(latent, jnp.asarray(0.5), jnp.array([0.1, 0, 0, 0]))
    assert muscle == pytest.approx(float(control[0]), rel=1e-4)


@needs_compiler
def test_vectors_of_value_and_gradient_lie_beside_it(lander: Path):
    vectors = json.loads(lander.with_name("lander.vectors.json").read_text())
    assert vectors["facts"]["system"] == "lander"
    assert np.shape(vectors["step"]["outputs"]["next_state"]) == (KEPT, 13)
    assert np.shape(vectors["vjp"]["outputs"]["by_control"]) == (KEPT, 4)
    assert np.shape(vectors["vjp"]["tolerance"]["by_state"]) == (13,)
    text = lander.read_text()
    assert text.isascii()
    assert "Weights: Apache-2.0." in text
    assert "LANDER_STATE_ROOT_ORIENTATION = 3, /* 4 [quaternion] */" in text


@needs_compiler
def test_a_function_that_does_something_else_is_refused():
    slow = load_emulator("pendulum-50")
    fast = load_emulator("pendulum-100")
    definition = definition_of(slow)
    vectors = make_vectors(definition, slow)
    gradients = make_gradient_vectors(definition, slow, vectors)
    right = compiled_header(c_header(slow, definition, "it"), "it")
    assert check_steps(right, vectors) < 1e-4
    assert check_gradients(right, gradients) < 1e-4
    wrong = compiled_header(c_header(fast, definition_of(fast), "it"), "it")
    with pytest.raises(NeuroAnimatorError, match="^step in C disagrees with JAX, so not"):
        check_steps(wrong, vectors)
    with pytest.raises(NeuroAnimatorError, match="^vjp in C disagrees with JAX"):
        check_gradients(wrong, gradients)


@needs_compiler
def test_a_batch_of_any_size_may_be_stepped_in_place_and_latent_states_go_on(lander: Path):
    emulator = load_emulator("lander-50")
    call = compiled_header(lander.read_text(), "lander")
    rng = np.random.default_rng(0)
    for count in (1, 15, 16, 33):
        bounds = emulator.bounds
        shares = rng.uniform(-1, 1, (3, count, 4))
        controls = (bounds.middle + shares * bounds.half).astype(np.float32)
        states = np.tile(emulator.rest.astype(np.float32), (count, 1))
        latents = np.zeros((count, stored_latent_size(emulator)), np.float32)
        for state, latent in zip(states, latents, strict=True):
            call("encode", state, latent)
        advanced = states.copy()
        expected = np.asarray(emulator.rollout(states, controls.swapaxes(0, 1)))[:, -1]
        for held in controls:
            call("step_batch", states, held, count, states)
            call("advance_batch", latents, held, count, advanced)
        np.testing.assert_allclose(states, expected, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(advanced, expected, rtol=1e-4, atol=1e-4)


@needs_compiler
def test_covers_says_what_the_emulator_says():
    emulator = load_emulator("pendulum-50")
    call = compiled_header(c_header(emulator, definition_of(emulator), "it"), "it")
    rest = emulator.rest.astype(np.float32)
    torque = np.zeros(3, np.float32)
    too_fast = rest + np.float32(100)
    for state, control in [
        (rest, torque),
        (rest, np.array([14, -14, 14], np.float32)),
        (rest, np.array([14.1, 0, 0], np.float32)),
        (rest, np.array([np.nan, 0, 0], np.float32)),
        (too_fast, torque),
        (rest * np.float32(np.nan), torque),
    ]:
        assert (call("covers", state, control) == 1) == emulator.covers(state, control)


def test_names_are_identifiers_whatever_a_file_calls_its_parts():
    assert identifier("pendulum-passive") == "pendulum_passive"
    assert identifier("3 legs") == "na_3_legs"
    assert identifier("größe") == "gr_e"
    assert identifier("*/ int main(") == "int_main"
    assert identifier("...") == "na_"
    layout = Layout(tuple(Slice(name, 1, "m") for name in ("a.b", "a b", "a_b", "A:B_1")))
    names = part_names(layout)
    assert len(set(names)) == 4
    assert names[0] == "A_B"


def test_no_text_of_an_emulator_reaches_the_header():
    emulator = load_emulator("pendulum-50")
    hostile = '*/\n#include "/etc/passwd"\n/*'
    definition = definition_of(emulator, hostile)
    definition = replace(definition, facts=definition.facts | {"system": hostile})
    comment, _, rest = c_header(emulator, definition, "it").partition("*/")
    assert comment.count("passwd") == 2
    assert "passwd" not in rest


def test_one_motion_and_sixteen_side_by_side_read_the_same_weights():
    constants = SharedConstants()
    weights = np.random.default_rng(0).normal(size=(21, 237))

    def product(weights: np.ndarray, x: jnp.ndarray) -> jnp.ndarray:
        return x @ weights

    c_function("one", product, weights, [Input((21,))], constants)
    size = constants.size
    c_function("lanes", product, weights, [Input((21,), is_wide=True)], constants)
    assert constants.size == size


def test_without_a_compiler_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(ResourceError, match=r"there is no C compiler: install gcc or clang"):
        write_c_header(load_emulator("pendulum-50"), tmp_path / "p.h")
    assert not list(tmp_path.iterdir())


@needs_compiler
def test_the_suffix_chooses_and_one_line_says_what_was_written(cli: Cli, tmp_path: Path):
    result = cli("export", "pendulum", "--out", "p.h", "--out", "p.onnx", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    header, graph = result.stdout.splitlines()
    assert header.startswith("p.h: ")
    assert "in C by" in header
    assert graph.startswith("p.onnx: ")


@pytest.mark.endurance
@needs_compiler
@pytest.mark.parametrize(("system", "substeps"), SHIPPED)
def test_every_emulator_that_ships_can_be_a_header(system: str, substeps: int, tmp_path: Path):
    written = write_c_header(load_emulator(f"{system}-{substeps}"), tmp_path / "it.h")
    assert written.difference < 1e-3


@pytest.mark.endurance
@needs_compiler
def test_an_emulator_of_a_body_that_is_pushed_can_be_a_header(
    untrained_cube: Emulator, tmp_path: Path
):
    assert write_c_header(untrained_cube, tmp_path / "it.h").difference < 1e-3


@pytest.mark.endurance
@needs_compiler
@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_that_ships_can_be_a_header(name: str, tmp_path: Path):
    assert write_c_header(load_policy(name), tmp_path / "it.h").difference < 1e-3


def test_no_slope_is_compared_at_a_kink_where_rounding_decides_which_there_is():
    emulator = load_emulator("pendulum-50")
    velocities = slice(3, 6)
    low = jnp.zeros_like(
        emulator.domain.low
    )  # so that at rest velocities are at an end of their range
    emulator = replace(emulator, domain=replace(emulator.domain, low=low))
    definition = definition_of(emulator)
    vectors = make_vectors(definition, emulator)
    gradients = make_gradient_vectors(definition, emulator, vectors)
    assert (vectors.inputs["state"][:, velocities] == 0).any()
    assert not (gradients.inputs["state"][:, velocities] == 0).any()
    assert gradients.count > 0.9 * vectors.count
