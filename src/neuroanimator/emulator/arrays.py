"""Arrays of users on their way into JAX and C."""

from __future__ import annotations

from typing import Any, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Num
from numpy.typing import ArrayLike


def too_large_is_infinite() -> np.errstate:
    """Return the block in which what is too large for float32 becomes infinite without a warning, as in JAX."""
    return np.errstate(over="ignore")


def is_plain(numbers: object) -> TypeGuard[np.ndarray]:
    """Return whether `numbers` are an array of NumPy, and of floats: what users mostly give."""
    return type(numbers) is np.ndarray and numbers.dtype.kind == "f"


def as_float32(numbers: ArrayLike) -> np.ndarray:
    """Return `numbers`, of any shape, as float32 in C's order; not copied if they are so already."""
    if (
        isinstance(numbers, np.ndarray)
        and numbers.dtype == np.float32
        and numbers.flags.c_contiguous
    ):
        return numbers
    with too_large_is_infinite():
        return np.asarray(numbers, np.float32, order="C")


def as_jax(numbers: ArrayLike, dtype: Any = np.float32) -> Num[Array, " ..."]:
    """Return `numbers`, of any shape, as a JAX array of the type `dtype`, converted by NumPy.

    `jnp.asarray` compiles a program for every shape it converts; this compiles nothing.
    """
    if isinstance(numbers, jax.Array):
        return jnp.asarray(numbers, dtype)
    with too_large_is_infinite():
        # A copy: JAX may keep the memory it is given, and users write into theirs.
        return jax.device_put(np.array(numbers, dtype))
