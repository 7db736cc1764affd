"""Eigenvectors and linear systems written out in products and sums.

JAX calls a library for them; generated programs cannot.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.extend.core as jaxprs
import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.codegen.trace import (
    LOOPS_AND_BRANCHES,
    UnsupportedError,
    bound,
    evaluated,
    nested_jaxpr,
)

SQUARINGS = 16
"""Number of times a matrix is squared: enough to separate eigenvalues one part in 10,000 apart."""

SOLVED = 3
"""Number of unknowns of the linear systems that are written out: Cramer's rule does not suit more."""


class _Omitted:
    """Stand-in for a value that only written-out operations read."""


def without_decompositions(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that computes the same as `function` without JAX's `eigh` and `linalg.solve`.

    Only the eigenvector of the largest eigenvalue is computed; the others are NaN.

    The returned function raises UnsupportedError for a number of unknowns other than three, and if factors of a matrix are
    used in any other way.
    """

    def written_out(*arguments: Any) -> Any:
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
        leaves = jax.tree.leaves(arguments)
        outputs = _written_out(closed, leaves)
        return jax.tree.unflatten(jax.tree.structure(shape), outputs)

    return written_out


def largest_eigenvector(matrix: Float[Array, "N N"]) -> Float[Array, " N"]:
    """Return the unit eigenvector (N,) of the largest eigenvalue of a symmetric `matrix` (N, N); its sign is arbitrary.

    High powers of a matrix tend to the projection onto that vector.
    """
    size = matrix.shape[0]
    bound = jnp.sqrt(jnp.sum(matrix * matrix))
    power = matrix + bound * jnp.eye(size, dtype=matrix.dtype)  # no eigenvalue is negative now
    for _ in range(SQUARINGS):
        trace = sum(power[i, i] for i in range(size))
        power = power / trace
        power = power @ power
    column = power[0]
    largest = power[0, 0]
    for i in range(1, size):
        entry = power[i, i]
        column = jnp.where(entry > largest, power[i], column)
        largest = jnp.maximum(entry, largest)
    return column / jnp.sqrt(jnp.sum(column * column))


def solve_three(matrix: Float[Array, "3 3"], right: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Return x (3,) with `matrix` (3, 3) · x = `right` (3,), by Cramer's rule."""
    first, second, third = matrix.T
    determinant = jnp.dot(first, jnp.cross(second, third))
    products = [
        jnp.dot(jnp.cross(second, third), right),
        jnp.dot(jnp.cross(third, first), right),
        jnp.dot(jnp.cross(first, second), right),
    ]
    return jnp.stack(products) / determinant


def _written_out(closed: jaxprs.ClosedJaxpr, inputs: list[Any]) -> list[Any]:
    """Return the outputs of `closed`, whose decompositions are written out."""
    return evaluated(closed.jaxpr, [*closed.consts, *inputs], lambda value: value, _equation)


def _equation(eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Any]:
    name = eqn.primitive.name
    if name == "eigh":
        return [_eigenvectors(inputs[0]), _Omitted()]
    if name == "lu":
        return [_Omitted() for _ in eqn.outvars]
    if name == "custom_linear_solve":
        return [_solution(eqn, inputs)]
    if any(isinstance(value, _Omitted) for value in inputs):
        raise UnsupportedError(f"{name} of factors of a matrix")
    inner = nested_jaxpr(eqn)
    if isinstance(inner, jaxprs.ClosedJaxpr) and name not in LOOPS_AND_BRANCHES:
        return _written_out(inner, inputs)
    return bound(eqn, inputs)


def _eigenvectors(matrix: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """Return eigenvectors as columns: the last is that of the largest eigenvalue, the others are NaN."""
    size = matrix.shape[0]
    unknown = jnp.full((size, size - 1), jnp.nan, matrix.dtype)
    return jnp.concatenate([unknown, largest_eigenvector(matrix)[:, None]], axis=1)


def _solution(eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> Any:
    """Return the solution of a linear system; the columns of its matrix are its products with unit vectors."""
    matvec = eqn.params["jaxprs"].matvec
    count = eqn.params["const_lengths"].matvec
    right = inputs[-1]
    if math.prod(right.shape) != SOLVED or len(eqn.outvars) != 1:
        raise UnsupportedError(f"a linear system of shape {right.shape}")
    columns = []
    for unit in jnp.eye(SOLVED, dtype=right.dtype):
        arguments = [*inputs[:count], unit.reshape(right.shape)]
        (column,) = _written_out(matvec, arguments)
        columns.append(column.ravel())
    return solve_three(jnp.stack(columns, axis=1), right.ravel()).reshape(right.shape)
