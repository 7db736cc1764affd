"""A formula in C is the formula in JAX, in float32 and in float64."""

from __future__ import annotations

import ctypes

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator.codegen.c_formula import c_formula
from neuroanimator.codegen.compiler import compiled_library, find_compiler
from neuroanimator.codegen.trace import UnsupportedError

NUMBER = (1,)
VECTOR = (1, 3)

CALLER = """
void apply(const real *v, const real *w, real a, real *product) {
    product[3] = speed(v, a);
    force(v, w, a, product);
}
"""


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
