"""Arrays of users on their way into JAX."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Num
from numpy.typing import ArrayLike


def as_jax(numbers: ArrayLike, dtype: Any = np.float32) -> Num[Array, ...]:
    """Return `numbers`, of any shape, as a JAX array of the type `dtype`, converted by NumPy.

    `jnp.asarray` compiles a program for every shape it converts; this compiles nothing.
    """
    if isinstance(numbers, jax.Array):
        return jnp.asarray(numbers, dtype)
    with np.errstate(over="ignore"):  # too large for float32 is infinite, as in JAX
        # A copy: JAX may keep the memory it is given, and users write into theirs.
        return jax.device_put(np.array(numbers, dtype))
