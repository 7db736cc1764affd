"""A map does in each of its forms what JAX does, and is refused where it does not."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from neuroanimator.codegen.c_map import (
    Caller,
    CMap,
    MapDefinition,
    c_struct,
    map_references,
    program_of_maps,
)
from neuroanimator.codegen.compiler import compiled_library, find_compiler
from neuroanimator.codegen.kept import FLAGS, LoadedProgram, WrongProgramError, aligned, declared
from neuroanimator.codegen.program import WIDTH

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
WEIGHTS = np.random.default_rng(0).normal(size=(18, 7)).astype(np.float32)


def layer(weights: Array, numbers: Array, x: Array) -> Array:
    return jnp.tanh(x @ weights) * numbers[0] + jnp.sin(numbers[1:].sum() * x[:7])


def nothing(weights: Array, numbers: Array, x: Array) -> Array:
    """A cost of nothing: some objectives have no terms of controls."""
    return jnp.zeros(0)


def compiled(function: Callable[..., Array], numbers: np.ndarray) -> tuple[CMap, MapDefinition]:
    definition = MapDefinition(function, jnp.asarray(WEIGHTS), 18)
    program = program_of_maps({"map": definition}, len(numbers))
    library = compiled_library(program.text, FLAGS)
    assert library is not None
    loaded = LoadedProgram(library, aligned(program.constants), program.sizes)
    return CMap(loaded, "map", numbers), definition


def check(in_c: CMap, definition: MapDefinition, numbers: np.ndarray) -> None:
    points = np.random.default_rng(1).normal(size=(WIDTH, 18)).astype(np.float32)
    (reference,) = map_references([definition.with_numbers(numbers)], [points])
    in_c.check(reference)


@needs_compiler
@pytest.mark.parametrize("function", [layer, nothing])
def test_every_form_of_a_map_does_what_jax_does(function: Callable[..., Array]):
    numbers = np.array([0.5, 1.0, -0.3], np.float32)
    check(*compiled(function, numbers), numbers)


@needs_compiler
def test_a_map_with_other_numbers_than_the_judge_is_refused():
    numbers = np.array([0.5, 1.0, -0.3], np.float32)
    in_c, definition = compiled(layer, numbers)
    with pytest.raises(WrongProgramError, match="'map'"):
        check(in_c, definition, 2 * numbers)


@needs_compiler
def test_more_or_fewer_than_sixteen_rows_are_computed_one_for_one():
    numbers = np.array([0.5, 1.0, -0.3], np.float32)
    in_c, _ = compiled(layer, numbers)
    xs = np.random.default_rng(1).normal(size=(WIDTH + 3, 18)).astype(np.float32)
    ys = in_c.of_rows(xs)
    for x, y in zip(xs, ys, strict=True):
        np.testing.assert_allclose(y, in_c.forward(x)[0], rtol=1e-5, atol=1e-6)


NESTED = """
long room(const void *nothing) { return 3; }
void lend(const void *nothing, void (*borrow)(void *), void *memory) { borrow(memory); }
"""
"""A function that hands on its working memory."""


@needs_compiler
def test_working_memory_is_lent_to_one_at_a_time_and_used_again():
    library = compiled_library(NESTED)
    assert library is not None
    declared(library, "room", 1, ctypes.c_long)
    declared(library, "lend", 3)
    call = Caller(library, c_struct(0), "room")
    lent: list[int] = []

    @ctypes.CFUNCTYPE(None, ctypes.c_void_p)
    def borrow(memory: int) -> None:
        lent.append(memory)
        if len(lent) == 1:
            call("lend", at)

    at = ctypes.cast(borrow, ctypes.c_void_p).value or 0
    call("lend", at)
    call("lend", at)
    first, second, third = lent
    assert first != second
    assert third in (first, second)
