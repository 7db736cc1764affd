"""Numbers on their way into JAX."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike


def as_jax(numbers: ArrayLike, kind: Any = np.float32) -> Array:
    """Return `numbers` as a JAX array of the type `kind`, converted by NumPy.

    `jnp.asarray` compiles a program for every shape it converts; this compiles nothing.
    """
    if isinstance(numbers, jax.Array):
        return jnp.asarray(numbers, kind)
    with np.errstate(over="ignore"):  # too large for float32 is infinite, as in JAX
        # A copy: JAX may keep the memory it is given, and users write into theirs.
        return jax.device_put(np.array(numbers, kind))
