"""Generated C does what JAX does, for single operations and for every kind of emulator."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import Emulator, NeuroAnimatorError, load_emulator
from neuroanimator.codegen import c_emulator as module
from neuroanimator.codegen.c_emulator import c_emulator, c_program
from neuroanimator.codegen.c_function import HEAD, c_function
from neuroanimator.codegen.program import UnsupportedError, trace
from neuroanimator.compiler import compiler
from neuroanimator.compiler.compiler import compiled_library, find_compiler

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
    "angles": (lambda x, y: jnp.arctan2(x, y) + jnp.round(3 * x), ((7,), (7,))),
    "weights": (lambda x: x @ WEIGHTS, ((21,),)),
    "weights from the left": (lambda x: WEIGHTS[:, :9].T @ x[::-1], ((21,),)),
    "few weights": (lambda x: x @ WEIGHTS[:3, :2], ((3,),)),
    "many weights": (lambda x: x @ jnp.tile(WEIGHTS, (2, 6)), ((42,),)),
    "rows of weights": (lambda x: x @ WEIGHTS, ((4, 21),)),
    "rotations": (lambda x, y: jnp.einsum("bij,bj->bi", x, y), ((5, 3, 3), (5, 3))),
    "constants": (
        lambda x: jnp.concatenate([x, jnp.arange(30.0)]) + jnp.linspace(0, 1, 35),
        ((5,),),
    ),
}


def called(library: ctypes.CDLL, inputs: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """Return what the compiled function `it` makes of `inputs`: an array of `shape`."""
    held = [np.ascontiguousarray(each, np.float32) for each in (*inputs, np.zeros(shape))]
    library.it(*(each.ctypes.data_as(ctypes.c_void_p) for each in held))
    return held[-1]


@needs_compiler
@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_is_the_same_in_c(name: str):
    function, shapes = FUNCTIONS[name]
    library = compiled_library(
        HEAD + c_function("it", function, *shapes).replace("static void", "void")
    )
    assert library is not None
    rng = np.random.default_rng(1)
    for _ in range(3):
        inputs = [rng.normal(size=shape).astype(np.float32) for shape in shapes]
        expected = np.asarray(function(*map(jnp.asarray, inputs)))
        np.testing.assert_allclose(
            called(library, inputs, expected.shape), expected, rtol=2e-5, atol=2e-6
        )


@needs_compiler
@pytest.mark.parametrize("name", ["truck-50", "lander-50", "dolphin-100", "cube-50"])
def test_every_kind_of_emulator_can_be_c_and_is_held_against_jax(name: str):
    assert c_emulator(load_emulator(name)) is not None


@needs_compiler
@pytest.mark.parametrize("name", ["pendulum-50", "fish-50"])
def test_a_rollout_is_the_same_in_c(name: str):
    emulator = load_emulator(name)
    program = c_emulator(emulator)
    assert program is not None
    rng = np.random.default_rng(0)
    bounds = emulator.bounds
    held = bounds.middle + rng.uniform(-1, 1, (10, len(bounds.half))) * bounds.half
    start, controls = emulator.encode_motion(emulator.rest, held)
    last = np.asarray(
        emulator.decode(jnp.asarray(program.play(np.asarray(start), np.asarray(controls))))
    )
    expected = np.asarray(emulator.rollout(emulator.rest, held))[-1]
    np.testing.assert_allclose(last, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def test_what_depends_on_constants_alone_is_computed_beforehand_and_moves_leave_no_code():
    program = trace(
        lambda x: jnp.concatenate([x[3:], x[:3] * (jnp.sin(jnp.arange(3.0)) + 2)])[::-1], (6,)
    )
    assert [operation.name for operation in program.operations] == ["mul"]
    assert program.outputs[0].tolist() == [
        *reversed(program.operations[0].output.tolist()),
        5,
        4,
        3,
    ]


def test_what_nobody_needs_is_dropped():
    program = trace(lambda x: (x * 2, jnp.tanh(x))[0], (6,))
    assert [operation.name for operation in program.operations] == ["mul"]


def test_loops_are_refused_by_name():
    with pytest.raises(UnsupportedError, match="'while'"):
        c_function(
            "it", lambda x: jax.lax.while_loop(lambda y: y.sum() < 9, lambda y: y + 1, x), (3,)
        )


@pytest.mark.parametrize(
    "function", [lambda x: x[x.argmax()], lambda x: jnp.arange(3.0)[x[0].astype(int)]]
)
def test_places_that_are_computed_are_refused(function: Callable):
    with pytest.raises(UnsupportedError):
        c_function("it", function, (3,))


def test_without_a_compiler_there_is_none(shipped: Emulator, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    assert c_emulator(shipped) is None


@needs_compiler
def test_a_program_that_does_something_else_is_refused(
    shipped: Emulator, monkeypatch: pytest.MonkeyPatch
):
    right = c_program(shipped)
    monkeypatch.setattr(module, "c_program", lambda emulator: right.replace("tanhf", "sinf"))
    with pytest.raises(NeuroAnimatorError, match="does not do what"):
        c_emulator(shipped)
