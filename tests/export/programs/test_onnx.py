"""An ONNX file does what its emulator or policy does in JAX, or is not written."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import numpy_runtime
import onnx
import onnxruntime
import pytest
from conftest import Cli
from npz_file import npz_bytes

from neuroanimator import Emulator, NeuroAnimatorError, Policy, load_emulator, write_onnx
from neuroanimator.codegen.trace import UnsupportedError
from neuroanimator.emulator.trust import EDGE
from neuroanimator.export.programs.definition import (
    Port,
    ProgramDefinition,
    definition_of,
)
from neuroanimator.export.programs.onnx_file import onnx_bytes, run_onnx, run_reference
from neuroanimator.export.programs.vectors import COUNT, KEPT, make_vectors
from neuroanimator.files.zoo import POLICIES, SHIPPED
from neuroanimator.state.layout import Layout, Slice

EMULATORS = sorted({system for system, _ in SHIPPED})
WEIGHTS = np.random.default_rng(0).normal(size=(6, 37)).astype(np.float32)

FUNCTIONS: dict[str, Callable] = {
    "arithmetic": lambda x, y: -x * y / (1 + y * y) + jnp.abs(x) ** 3 - x**-2 + jnp.square(y),
    "functions": lambda x, y: jnp.tanh(x) + jax.nn.sigmoid(y) * jnp.exp(jnp.sin(x)) + jnp.cos(y),
    "roots": lambda x, y: jnp.sqrt(x * x + 1) + jax.lax.rsqrt(y * y + 1) + jnp.log(1 + x * x),
    "whole numbers": lambda x, y: jnp.round(3 * x) + jnp.floor(y) + jnp.ceil(x) + jnp.sign(y),
    "choices": lambda x, y: jnp.where((x > y) & (x < 1), x, jnp.maximum(y, jnp.clip(x, -0.5, 0.5))),
    "comparisons": lambda x, y: jnp.where((x >= y) | ~(x <= 1), x, y) + (x != y) + (x == x),
    "angles": lambda x, y: jnp.arctan2(x, y) + jnp.arctan2(0 * jnp.abs(x), y) + jnp.arctan2(0 * x, 0 * y + 1),
    "moves": lambda x, y: jnp.stack([x[::-1], jnp.roll(y, 3), x[jnp.array([5, 1, 1, 0, 0, 2])]])
    .T.ravel()[::2],
    "constants among them": lambda x, y: jnp.concatenate([x, jnp.arange(3.0), y[:2]])[::-1],
    "constants alone": lambda x, y: jnp.arange(3.0),
    "reductions": lambda x, y: jnp.stack(
        [x.reshape(2, 3).sum(axis=0), y.reshape(3, 2).max(axis=1), x.reshape(2, 3).min(axis=0)]
    ).ravel(),
    "one number of many": lambda x, y: x * y.sum() + x.prod(),
    "the same number everywhere": lambda x, y: jnp.broadcast_to(x[0] * y[1], (5,)) + 1,
    "weights": lambda x, y: x @ WEIGHTS,
    "weights from the left": lambda x, y: WEIGHTS[:, :6].T @ x[::-1],
    "rows of weights": lambda x, y: (jnp.outer(x, y) @ WEIGHTS).ravel(),
    "matrices": lambda x, y: (x.reshape(3, 2) @ y.reshape(2, 3)).ravel(),
    "many matrices": lambda x, y: jnp.einsum("bij,bjk->bik", x.reshape(3, 1, 2), y.reshape(3, 2, 1)).ravel(),
    "an eigenvector": lambda x, y: _signed(jnp.linalg.eigh(jnp.outer(x, x) + jnp.eye(6) * y * y)[1][:, -1]),
    "a linear system": lambda x, y: jnp.linalg.solve(jnp.outer(x[:3], x[:3]) + 2 * jnp.eye(3), y[:3]),
}  # fmt: skip


def _signed(vector: jax.Array) -> jax.Array:
    return vector * jnp.where(vector[0] < 0, -1.0, 1.0)


def six_numbers(function: Callable) -> ProgramDefinition:
    """Return the definition of a `function` of two arrays (6,)."""
    shape = jax.eval_shape(function, jnp.zeros(6), jnp.zeros(6)).shape
    six = Layout((Slice("six", 6, "1"),))
    outputs = (Port("z", Layout((Slice("z", int(np.prod(shape)), "1"),))),)
    inputs = (Port("x", six), Port("y", six))
    return ProgramDefinition(
        "six", lambda x, y: (function(x, y),), inputs, outputs, {"kind": "function"}
    )


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("batch", [1, 5])
def test_a_function_is_the_same_in_onnx(name: str, batch: int):
    content = onnx_bytes(six_numbers(FUNCTIONS[name]))
    rng = np.random.default_rng(1)
    x, y = (rng.normal(size=(batch, 6)).astype(np.float32) for _ in range(2))
    feeds = {"x": x, "y": y}
    _, computed = run_onnx(content, feeds)
    expected = np.asarray(jax.jit(jax.vmap(FUNCTIONS[name]))(x, y))
    np.testing.assert_allclose(computed["z"], expected, rtol=2e-5, atol=2e-5)
    reference = run_reference(content, feeds)["z"]
    np.testing.assert_allclose(reference, expected, rtol=2e-5, atol=2e-5)
    in_numpy = numpy_runtime.load(io.BytesIO(npz_bytes(six_numbers(FUNCTIONS[name]))))
    np.testing.assert_allclose(in_numpy.run(x, y), expected, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize(
    "function",
    [
        lambda x, y: jax.lax.while_loop(lambda z: z.sum() < 9, lambda z: z + 1, x),
        lambda x, y: jnp.linalg.solve(jnp.outer(x, x) + jnp.eye(6), y),
        lambda x, y: jax.scipy.linalg.lu_factor(jnp.outer(x, x))[0][0],
        lambda x, y: jax.lax.round(x, jax.lax.RoundingMethod.AWAY_FROM_ZERO),
    ],
)
def test_what_there_is_no_operator_for_is_refused(function: Callable):
    with pytest.raises(UnsupportedError, match="No code can be generated for the JAX operation"):
        onnx_bytes(six_numbers(function))


def test_an_eigenvector_that_is_not_computed_is_no_number():
    def smallest(x: jax.Array, y: jax.Array) -> jax.Array:
        return jnp.linalg.eigh(jnp.outer(x, x) + jnp.eye(6) * y)[1][:, 0]

    ones = np.ones((1, 6), np.float32)
    _, computed = run_onnx(onnx_bytes(six_numbers(smallest)), {"x": ones, "y": ones})
    assert np.isnan(computed["z"]).all()


def models() -> list:
    """Return one emulator of every system that has one, and every policy, by what loads it."""
    emulators = [
        pytest.param(Emulator.load, name, id=name, marks=long_of(name)) for name in EMULATORS
    ]
    policies = [
        pytest.param(Policy.load, name, id=f"{name} policy", marks=long_of(name))
        for name in POLICIES
    ]
    return emulators + policies


def long_of(name: str) -> Sequence[pytest.MarkDecorator]:
    """Return the marks of a model's tests: the dolphin and a family of fishes are made as the fish is."""
    return [pytest.mark.endurance] if name in ("dolphin", "fishes") else []


@pytest.mark.parametrize(("load", "name"), models())
def test_every_kind_of_model_is_the_same_in_onnxruntime_at_any_batch(load: Callable, name: str):
    assert_same_in_onnxruntime(load(name))


def test_a_body_that_is_pushed_is_the_same_in_onnxruntime_at_any_batch(untrained_cube: Emulator):
    assert_same_in_onnxruntime(untrained_cube)


def assert_same_in_onnxruntime(model: Emulator | Policy) -> None:
    definition = definition_of(model, has_trust=True)
    session = onnxruntime.InferenceSession(onnx_bytes(definition))
    emulator = model.emulator if isinstance(model, Policy) else model
    rng = np.random.default_rng(0)
    near_rest = emulator.rest + rng.normal(0, 0.01, (7, emulator.state.size))
    others = [rng.uniform(-1, 1, (7, port.layout.size)) for port in definition.inputs[1:]]
    arrays = [array.astype(np.float32) for array in (near_rest, *others)]
    expected = jax.jit(jax.vmap(definition.function))(*arrays)
    for batch in (1, 7):
        feeds = {}
        for port, array in zip(definition.inputs, arrays, strict=True):
            feeds[port.name] = array[:batch]
        computed = session.run(definition.output_names, feeds)
        for found, wanted in zip(computed, expected, strict=True):
            np.testing.assert_allclose(found, wanted[:batch], rtol=1e-4, atol=1e-4)


@pytest.mark.endurance
@pytest.mark.parametrize(("system", "substeps"), SHIPPED)
def test_every_emulator_that_ships_is_written_and_checked(
    system: str, substeps: int, tmp_path: Path
):
    written = write_onnx(load_emulator(f"{system}-{substeps}"), tmp_path / "it.onnx")
    onnx.checker.check_model(onnx.load(written.path), full_check=True)
    assert (written.checked, written.difference < 1e-3) == (COUNT, True)


@pytest.mark.endurance
def test_a_body_that_is_pushed_is_written_and_checked(untrained_cube: Emulator, tmp_path: Path):
    written = write_onnx(untrained_cube, tmp_path / "it.onnx")
    assert (written.checked, written.difference < 1e-3) == (COUNT, True)


def test_a_file_says_what_its_numbers_are_and_vectors_lie_beside_it(tmp_path: Path):
    path = tmp_path / "pendulum.onnx"
    written = write_onnx(load_emulator("pendulum-50"), path, "Apache-2.0")
    assert written.size == path.stat().st_size
    assert sorted(tmp_path.iterdir()) == [path, tmp_path / "pendulum.vectors.json"]
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    facts = {entry.key: entry.value for entry in model.metadata_props}
    assert facts["system"] == "pendulum"
    assert facts["licence"] == "Apache-2.0"
    assert (json.loads(facts["dt"]), json.loads(facts["substeps"])) == (0.05, 50)
    assert json.loads(facts["control"]) == [["torque", 3, "N·m"]]
    assert json.loads(facts["control_high"])[1] == 14
    batch = model.graph.input[0].type.tensor_type.shape.dim[0]
    assert batch.dim_param == "batch"

    (vectors_path,) = written.others
    vectors = json.loads(vectors_path.read_text())["step"]
    feeds = {name: np.array(rows, np.float32) for name, rows in vectors["inputs"].items()}
    _, computed = run_onnx(path.read_bytes(), feeds)
    for name, size in {"next_state": 6, "trust": 1}.items():
        expected = np.array(vectors["outputs"][name])
        assert expected.shape == (KEPT, size)
        assert (np.abs(computed[name] - expected) <= vectors["tolerance"][name]).all()


def trust_outside(emulator: Emulator, states: np.ndarray, controls: np.ndarray) -> dict:
    """Return the scores (B,) of states under controls by each runtime of a file, by its name."""
    definition = definition_of(emulator, has_trust=True)
    feeds = {"state": np.float32(states), "control": np.float32(controls)}
    content = onnx_bytes(definition)
    in_numpy = numpy_runtime.load(io.BytesIO(npz_bytes(definition)))
    with np.errstate(all="ignore"):  # onnx' own evaluator warns of what is no number
        reference = run_reference(content, feeds)
    return {
        "onnxruntime": run_onnx(content, feeds)[1]["trust"][:, 0],
        "onnx": reference["trust"][:, 0],
        "NumPy": in_numpy.trust(states, controls),
        "NumPy's step": in_numpy.step_trusted(states, controls)[1],
    }


def test_what_is_no_number_or_too_large_is_trusted_nowhere():
    lander = load_emulator("lander-50")
    inputs = np.concatenate([lander.rest, lander.bounds.middle])
    rows = [inputs]
    for entry in range(len(inputs)):
        for wrong in (np.nan, np.inf, -np.inf, 3e6):
            row = inputs.copy()
            row[entry] = wrong
            rows.append(row)
    states, controls = np.split(np.array(rows), [lander.state.size], axis=1)
    for runtime, scores in trust_outside(lander, states, controls).items():
        assert scores[0] <= EDGE, runtime
        assert (scores[1:] == np.inf).all(), runtime


def test_scores_outside_are_the_emulators_wherever_an_input_lies():
    lander = load_emulator("lander-50")
    definition = definition_of(lander, has_trust=True)
    vectors = make_vectors(definition, lander)
    states, controls = vectors.inputs["state"], vectors.inputs["control"]
    expected = lander.trust(states.astype(float), controls.astype(float))
    assert expected.min() < 0.5 * EDGE
    assert expected.max() > EDGE
    for runtime, scores in trust_outside(lander, states, controls).items():
        np.testing.assert_allclose(scores, expected, rtol=1e-3, atol=1e-3, err_msg=runtime)


def test_of_a_file_from_before_there_were_scores_there_is_none_which_is_said(tmp_path: Path):
    old = replace(load_emulator("pendulum-50"), meter=None)
    written = write_onnx(old, tmp_path / "old.onnx")
    assert "No trust: the file is too old to have trust scores" in written.summary()
    assert [output.name for output in onnx.load(written.path).graph.output] == ["next_state"]
    in_numpy = numpy_runtime.load(io.BytesIO(npz_bytes(definition_of(old, has_trust=True))))
    assert in_numpy.step(old.rest, np.zeros(3)).shape == (6,)
    with pytest.raises(ValueError, match="no trust scores"):
        in_numpy.trust(old.rest, np.zeros(3))


def test_the_same_emulator_gives_the_same_bytes():
    definition = definition_of(load_emulator("pendulum-50"), has_trust=True)
    assert onnx_bytes(definition) == onnx_bytes(definition)


def test_inputs_lie_within_training_at_its_border_and_beyond():
    emulator = load_emulator("lander-50")
    vectors = make_vectors(definition_of(emulator), emulator)
    states = vectors.inputs["state"]
    controls = vectors.inputs["control"]
    is_covered = emulator.trust(states.astype(float), controls.astype(float)) <= EDGE
    assert 0.6 < is_covered.mean() < 0.95
    assert (np.abs(np.linalg.norm(states[:, 3:7], axis=1) - 1) < 1e-6).all()
    assert emulator.bounds.contain(controls)
    assert (controls == np.array(emulator.bounds.high, np.float32)).any(axis=0).all()
    assert (controls == np.array(emulator.bounds.low, np.float32)).any(axis=0).all()


def test_a_program_that_does_something_else_is_refused():
    slow = load_emulator("pendulum-50")
    fast = load_emulator("pendulum-100")
    vectors = make_vectors(definition_of(slow), slow)
    _, computed = run_onnx(onnx_bytes(definition_of(slow)), vectors.inputs)
    assert vectors.check(computed, "It") < 1e-4
    _, computed = run_onnx(onnx_bytes(definition_of(fast)), vectors.inputs)
    with pytest.raises(NeuroAnimatorError, match="It disagrees with JAX, so nothing"):
        vectors.check(computed, "It")
    computed = vectors.expected["next_state"].copy()
    computed[3, 2] = np.nan
    with pytest.raises(NeuroAnimatorError, match="of 1000 inputs 1 differ, the first in next_st"):
        vectors.check({"next_state": computed}, "It")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["pendulum", "--out", "p.exe"], 2, "'p.exe' ends in none of .h, .wasm, .onnx"),
        (
            ["pendulum", "--out", "p.onnx", "--out", "p.exe"],
            2,
            "'p.exe' ends in none of .h, .wasm, .onnx",
        ),
        (["pendulm", "--out", "p.onnx"], 3, "No emulator file 'pendulm'"),
        (["pendulum", "--policy", "--out", "p.onnx"], 3, "No policy file 'pendulum'"),
        (["swing.csv", "--out", "swing.glb"], 2, "a clip needs --emulator"),
        (["swing.csv", "--emulator", "pendulum", "--out", "swing.onnx"], 2, "none of .csv, .glb"),
    ],
)
def test_a_mistake_gets_one_line_and_no_file(
    arguments: list[str], code: int, message: str, cli: Cli, tmp_path: Path
):
    result = cli("export", *arguments, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (code, "")
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_name_means_the_emulator_and_policy_asks_for_the_policy(cli: Cli, tmp_path: Path):
    result = cli("export", "fish", "--policy", "--out", "swim.onnx", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("swim.onnx: ")
    assert result.stdout.count("\n") == 1
    model = onnx.load(tmp_path / "swim.onnx")
    facts = {entry.key: entry.value for entry in model.metadata_props}
    assert (facts["kind"], facts["licence"]) == ("policy", "Apache-2.0")
    assert [entry.name for entry in model.graph.input] == ["state", "phase", "command"]
    assert json.loads(facts["phase_per_step"]) == pytest.approx(Policy.load("fish").tick)
