"""Generated C does what JAX does, value and gradient, one motion at a time and sixteen side by side."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator.codegen.c_formula import c_formula
from neuroanimator.codegen.c_function import CFunction, c_function, prelude
from neuroanimator.codegen.compiler import compiled_library, find_compiler
from neuroanimator.codegen.kept import FLAGS, aligned
from neuroanimator.codegen.program import WIDTH, Constants
from neuroanimator.codegen.trace import Input, UnsupportedError, trace

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
WEIGHTS = np.random.default_rng(0).normal(size=(21, 37)).astype(np.float32)
EVENS = np.arange(0, 12, 2)

FUNCTIONS: dict[str, tuple[Callable, tuple[tuple[int, ...], ...]]] = {
    "arithmetic": (lambda x, y: -x * y / (1 + y * y) + jnp.abs(x) ** 3 - x**-2, ((40,), (40,))),
    "few and many": (lambda x, y: jnp.concatenate([x * 2, y[:2] + x, y])[1:], ((2,), (40,))),
    "functions": (
        lambda x: jnp.tanh(x) + jax.nn.sigmoid(x) * jnp.exp(jnp.sin(x)) + jnp.sqrt(x * x + 1),
        ((33,),),
    ),
    "logarithms": (lambda x: jnp.log(x * x + 0.1) + jnp.cos(x), ((33,),)),
    "choices": (
        lambda x, y: jnp.where((x > y) & (x < 1), x, jnp.maximum(y, jnp.clip(x, -0.5, 0.5))),
        ((20,), (20,)),
    ),
    "moves": (
        lambda x: jnp.stack([x[::-1], jnp.roll(x, 3), x[jnp.array([5, 1, 1] * 4)]]).T.ravel()[
            EVENS
        ],
        ((12,),),
    ),
    "sums": (lambda x: x.sum(axis=0) * x.max(axis=1).min() + jnp.mean(x, where=x > 0), ((5, 9),)),
    "long sums": (lambda x: jnp.sum(x**2, axis=1), ((3, 40),)),
    "angles": (lambda x, y: jnp.arctan2(x, y) + jnp.round(3 * x), ((7,), (7,))),
    "weights": (lambda x: x @ WEIGHTS, ((21,),)),
    "weights from the left": (lambda x: WEIGHTS[:, :9].T @ x[::-1], ((21,),)),
    "few weights": (lambda x: x @ WEIGHTS[:3, :2], ((3,),)),
    "many weights": (lambda x: x @ jnp.tile(WEIGHTS, (2, 6)), ((42,),)),
    "rows of weights": (lambda x: x @ WEIGHTS, ((4, 21),)),
    "rotations": (lambda x, y: jnp.einsum("bij,bj->bi", x, y), ((5, 3, 3), (5, 3))),
    "many rotations": (lambda x, y: jnp.einsum("ij,bj->bi", x, y), ((3, 3), (30, 3))),
    "constants": (
        lambda x: jnp.concatenate([x, jnp.arange(30.0)]) + jnp.linspace(0, 1, 35),
        ((5,),),
    ),
}

LARGEST = 40 * 40
"""Numbers of the largest array here."""

NUMBER = (1,)
VECTOR = (1, 3)

CALLER = """
void apply(const real *v, const real *w, real a, real *product) {
    product[3] = speed(v, a);
    force(v, w, a, product);
}
"""


def compiled(function: CFunction, constants: Constants) -> Callable[[str, list[np.ndarray]], None]:
    """Return what calls a C function of the text by its name, with the constants and these arrays."""
    text = prelude() + function.text.replace("static void", "void")
    library = compiled_library(text, FLAGS)
    assert library is not None
    numbers = aligned(constants.data())

    def call(name: str, arrays: list[np.ndarray]) -> None:
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (numbers, *arrays)]
        getattr(library, name)(*pointers)

    return call


def room(*shape: int) -> np.ndarray:
    """Return an array that begins where the widest register may."""
    return aligned(np.zeros(int(np.prod(shape)), np.float32)).reshape(shape)


def random_inputs(shapes: tuple[tuple[int, ...], ...], seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.normal(size=shape).astype(np.float32) for shape in shapes]


def without_module(function: Callable) -> Callable:
    return lambda _, *arrays: function(*arrays)


@needs_compiler
@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_is_the_same_in_c(name: str):
    function, shapes = FUNCTIONS[name]
    constants = Constants()
    written = c_function(
        "it", without_module(function), None, list(map(Input, shapes)), constants=constants
    )
    call = compiled(written, constants)
    in_jax = jax.jit(function)
    for seed in range(3):
        inputs = random_inputs(shapes, seed)
        expected = np.asarray(in_jax(*inputs))
        found = room(*expected.shape)
        call("it", [*inputs, found])
        np.testing.assert_allclose(found, expected, rtol=2e-5, atol=2e-6)


@needs_compiler
@pytest.mark.parametrize("name", FUNCTIONS)
def test_sixteen_lanes_are_sixteen_calls(name: str):
    function, shapes = FUNCTIONS[name]
    constants = Constants()
    wide = [Input(shape, is_wide=True) for shape in shapes]
    written = c_function("it", without_module(function), None, wide, constants=constants)
    call = compiled(written, constants)
    lanes = [random_inputs(shapes, seed) for seed in range(WIDTH)]
    in_jax = jax.jit(function)
    expected = np.stack([np.asarray(in_jax(*lane)) for lane in lanes], axis=-1)
    found = room(*expected.shape)
    together = [np.stack(arrays, axis=-1) for arrays in zip(*lanes, strict=True)]
    call("it", [*together, found])
    np.testing.assert_allclose(found, expected, rtol=2e-5, atol=2e-6)


def pulled_back(function: Callable) -> Callable:
    """Return (arrays..., cotangent) → (value, cotangents of the arrays...)."""

    def value_and_pull(*arrays: jax.Array) -> tuple[jax.Array, ...]:
        value, pull = jax.vjp(function, *arrays[:-1])
        return value, *pull(arrays[-1])

    return value_and_pull


@needs_compiler
@pytest.mark.parametrize("is_wide", [False, True], ids=["one cotangent", "sixteen cotangents"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_gradient_is_the_same_in_c(name: str, is_wide: bool):
    function, shapes = FUNCTIONS[name]
    inputs = random_inputs(shapes, 1)
    value = np.asarray(jax.jit(function)(*inputs))
    rng = np.random.default_rng(2)
    lanes = (WIDTH,) if is_wide else ()
    cotangents = rng.normal(size=(*value.shape, *lanes)).astype(np.float32)
    pull = pulled_back(function)
    constants = Constants()
    late = Input(value.shape, is_wide=is_wide, is_late=True)
    written = c_function(
        "it", without_module(pull), None, [*map(Input, shapes), late], constants=constants
    )
    call = compiled(written, constants)
    tape = room(written.tape + WIDTH)
    wide_tape = room(WIDTH * (written.wide_tape + 1))
    found_value = room(*value.shape)
    call("it_forward", [*inputs, tape, wide_tape, found_value])
    np.testing.assert_allclose(found_value, value, rtol=2e-5, atol=2e-6)
    found = [room(*shape, *lanes) for shape in shapes]
    call("it_backward", [tape, wide_tape, cotangents, *found])
    in_jax = jax.jit(pull)
    for lane in range(WIDTH if is_wide else 1):
        cotangent = cotangents[..., lane] if is_wide else cotangents
        for entry, expected in zip(found, in_jax(*inputs, cotangent)[1:], strict=True):
            each = entry[..., lane] if is_wide else entry
            np.testing.assert_allclose(each, expected, rtol=1e-4, atol=1e-5)


@needs_compiler
@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("exp", -80, 80), ("tanh", -12, 12), ("sin", -1e4, 1e4), ("cos", -1e4, 1e4), ("log", 1e-6, 1e6), ("logistic", -30, 30)],
)  # fmt: skip
def test_an_elementary_function_is_right_to_a_few_units_of_the_last_place(
    name: str, low: float, high: float
):
    function = {"logistic": jax.nn.sigmoid}.get(name) or getattr(jnp, name)
    exact = {"logistic": lambda x: 1 / (1 + np.exp(-x))}.get(name) or getattr(np, name)
    constants = Constants()
    count = 1000
    written = c_function(
        "it", without_module(function), None, [Input((count,))], constants=constants
    )
    inputs = np.linspace(low, high, count, dtype=np.float32)
    found = room(count)
    compiled(written, constants)("it", [inputs, found])
    expected = exact(inputs.astype(float))
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=2e-7)


@needs_compiler
def test_what_is_not_a_number_stays_so():
    constants = Constants()
    function = lambda x: jnp.tanh(jnp.clip(x, -1, 1)) + jnp.exp(jnp.maximum(x, 0))  # noqa: E731
    written = c_function("it", without_module(function), None, [Input((20,))], constants=constants)
    found = room(20)
    compiled(written, constants)("it", [np.full(20, np.nan, np.float32), found])
    assert np.isnan(found).all()


def test_what_depends_on_constants_alone_is_computed_beforehand_and_moves_leave_no_code():
    program = trace(
        lambda _, x: jnp.concatenate([x[3:], x[:3] * (jnp.sin(jnp.arange(3.0)) + 2)])[::-1],
        None,
        Input((6,)),
    )
    assert [operation.name for operation in program.operations] == ["mul"]
    product = reversed(program.operations[0].output.tolist())
    assert program.outputs[0].tolist() == [*product, 5, 4, 3]


def test_what_nobody_needs_is_dropped():
    program = trace(lambda _, x: (x * 2, jnp.tanh(x))[0], None, Input((6,)))
    assert [operation.name for operation in program.operations] == ["mul"]


def test_what_is_asked_for_twice_is_computed_once():
    program = trace(lambda _, x: jnp.sin(x) * jnp.cos(x) + jnp.sin(x), None, Input((9,)))
    assert [operation.name for operation in program.operations] == ["sin", "cos", "mul", "add"]


def test_a_choice_that_is_known_leaves_no_code():
    program = trace(lambda _, x: jnp.where(np.arange(9) < 4, x, x[::-1]), None, Input((9,)))
    assert not program.operations
    (output,) = program.outputs
    np.testing.assert_array_equal(output, [0, 1, 2, 3, 4, 3, 2, 1, 0])


def test_a_long_chain_of_values_takes_the_room_of_two():
    def chain(_: None, x: jax.Array) -> jax.Array:
        for _step in range(30):
            x = jnp.tanh(x)
        return x

    text = c_function("chain", chain, None, [Input((40,))], Constants()).text
    assert f"float w[{2 * 48}];" in text


def test_adding_and_multiplying_by_zeros_and_ones_of_the_definition_leaves_no_code():
    def function(_: None, x: jax.Array) -> jax.Array:
        mask = jnp.array([0.0, 1.0] * 3)
        return (x + jnp.zeros(6)) * jnp.ones(6) - jnp.zeros(6) + 0.0 * x * mask

    assert not trace(function, None, Input((6,))).operations


def test_weights_are_data_so_that_the_text_is_shared():
    def function(weights: dict, x: jax.Array) -> jax.Array:
        return jnp.tanh(x @ weights["matrix"] + weights["shift"]) * weights["scale"]

    def text_with(seed: int) -> str:
        matrix, shift, scale = random_inputs(((21, 37), (37,), ()), seed)
        weights = {"matrix": jnp.asarray(matrix), "shift": shift, "scale": jnp.asarray(scale)}
        return c_function("it", function, weights, [Input((21,))], constants=Constants()).text

    assert text_with(0) == text_with(1)


def test_loops_are_refused_by_name():
    def function(_: None, x: jax.Array) -> jax.Array:
        return jax.lax.while_loop(lambda y: y.sum() < 9, lambda y: y + 1, x)

    with pytest.raises(UnsupportedError, match="'while'"):
        c_function("it", function, None, [Input((3,))], constants=Constants())


@pytest.mark.parametrize(
    "function", [lambda _, x: x[x.argmax()], lambda _, x: jnp.arange(3.0)[x[0].astype(int)]]
)
def test_places_that_are_computed_are_refused(function: Callable):
    with pytest.raises(UnsupportedError):
        c_function("it", function, None, [Input((3,))], constants=Constants())


@needs_compiler
def test_eigenvectors_are_those_of_jax():
    def function(_: None, x: jax.Array) -> jax.Array:
        vectors = jnp.linalg.eigh(x + x.T)[1]
        return vectors * jnp.sign(vectors[0])

    constants = Constants()
    call = compiled(
        c_function("it", function, None, [Input((4, 4))], constants=constants), constants
    )
    for seed in range(5):
        (matrix,) = random_inputs(((4, 4),), seed)
        found = room(4, 4)
        call("it", [matrix, found])
        np.testing.assert_allclose(found, function(None, jnp.asarray(matrix)), atol=1e-5)


def speed(v: jax.Array, a: jax.Array) -> jax.Array:
    """Return a number of a vector and a number."""
    return jnp.clip(jnp.sqrt(v[:, 0] ** 2 + v[:, 1] * v[:, 2] / a) - 0.1, 0, 7) ** 3


def force(v: jax.Array, w: jax.Array, a: jax.Array) -> jax.Array:
    """Return a vector of vectors and a number."""
    return (v * 9.81 - w / 3).at[:, 2].add(jnp.maximum(-a, 2 * a))


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_formula_in_c_is_the_formula_in_jax(dtype: type[np.floating]):
    real = "float" if dtype is np.float32 else "double"
    formulas = [
        c_formula("speed", speed, VECTOR, NUMBER),
        c_formula("force", force, VECTOR, VECTOR, NUMBER),
    ]
    head = (
        f"#include <math.h>\ntypedef {real} real;\n#define AXIS 1\n#define INLINE static inline\n"
    )
    library = compiled_library(head + "\n".join(formulas) + CALLER)
    assert library is not None
    rng = np.random.default_rng(0)
    v, w = rng.uniform(0.5, 2, (2, 1, 3)).astype(dtype)
    a = dtype(1.7)
    found = np.zeros(4, dtype)
    pointers = [numbers.ctypes.data_as(ctypes.c_void_p) for numbers in (v, w, found)]
    number = (ctypes.c_float if dtype is np.float32 else ctypes.c_double)(a)
    library.apply(pointers[0], pointers[1], number, pointers[2])
    with jax.enable_x64(True):
        one = jnp.array([a])
        expected = np.append(force(jnp.array(v), jnp.array(w), one), speed(jnp.array(v), one))
    np.testing.assert_allclose(found, expected, rtol=20 * np.finfo(dtype).eps)


def test_what_has_no_c_in_both_precisions_is_refused():
    with pytest.raises(UnsupportedError, match="sin"):
        c_formula("wave", jnp.sin, NUMBER)
