"""Operations that are known before a program runs have the bits that JAX gives them, vanishing numbers aside."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator.codegen.trace import EXACT, _results_now

SPECIAL = [0.0, -0.0, np.inf, -np.inf, np.nan, 1e-18, 3e38, 1.0, -2.5]
FLOATS = np.array(
    [*SPECIAL, *np.random.default_rng(0).normal(size=55) * 10.0 ** np.linspace(-15, 15, 55)],
    np.float32,
)
WHOLE = np.arange(-32, 32, dtype=np.int32)
UNARY = {"neg": jax.lax.neg, "sqrt": jax.lax.sqrt, "square": jax.lax.square}
BINARY = {
    "add": jax.lax.add,
    "sub": jax.lax.sub,
    "mul": jax.lax.mul,
    "div": jax.lax.div,
    "max": jax.lax.max,
    "min": jax.lax.min,
    "eq": jax.lax.eq,
    "ne": jax.lax.ne,
    "lt": jax.lax.lt,
    "le": jax.lax.le,
    "gt": jax.lax.gt,
    "ge": jax.lax.ge,
}


def assert_same(function, *arrays: np.ndarray) -> None:
    (eqn,) = jax.make_jaxpr(function)(*arrays).eqns
    (found,) = _results_now(eqn, list(arrays))
    expected = np.asarray(function(*arrays))
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(expected))


@pytest.mark.parametrize("name", BINARY)
def test_of_two_numbers(name: str):
    shifted = np.roll(FLOATS, 7)
    assert_same(BINARY[name], FLOATS, shifted)
    divisors = np.where(np.roll(WHOLE, 5) == 0, 3, np.roll(WHOLE, 5)).astype(np.int32)
    assert_same(BINARY[name], WHOLE, divisors)


def test_of_one_number():
    assert {*UNARY, *BINARY, "add_any", "select_n"} == set(EXACT)
    for function in UNARY.values():
        assert_same(function, FLOATS)


def test_of_choices_conversions_and_counts():
    chosen = FLOATS > 0
    assert_same(jax.lax.select_n, chosen, FLOATS, np.roll(FLOATS, 3))
    assert_same(lambda x: jax.lax.convert_element_type(x, np.float32), WHOLE)
    assert_same(lambda x: jax.lax.convert_element_type(x, np.float32), chosen)
    (eqn,) = jax.make_jaxpr(lambda: jax.lax.broadcasted_iota(np.int32, (3, 4), 1))().eqns
    np.testing.assert_array_equal(_results_now(eqn, [])[0], jnp.indices((3, 4))[1])
