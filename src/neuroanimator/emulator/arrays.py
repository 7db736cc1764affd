"""Conversion of users' arrays for JAX and C."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num
from numpy.typing import ArrayLike

from neuroanimator.state.arrays import AnyArray


def too_large_is_infinite() -> np.errstate:
    """Return the context in which numbers too large for float32 become infinite without a warning, as in JAX."""
    return np.errstate(over="ignore")


def is_plain(numbers: object) -> TypeGuard[np.ndarray]:
    """Return whether `numbers` is a NumPy array of floats, the usual input."""
    return type(numbers) is np.ndarray and numbers.dtype.kind == "f"


def as_float32(numbers: ArrayLike) -> np.ndarray:
    """Return `numbers`, of any shape, as float32 in C order; not copied if they already are."""
    if (
        isinstance(numbers, np.ndarray)
        and numbers.dtype == np.float32
        and numbers.flags.c_contiguous
    ):
        return numbers
    with too_large_is_infinite():
        return np.asarray(numbers, np.float32, order="C")


def as_state(numbers: np.ndarray) -> np.ndarray:
    """Return the numbers of a state in C order: float32 if they are, otherwise float64; not copied if they already are."""
    return np.ascontiguousarray(numbers, state_type(numbers))


def state_type(state: ArrayLike) -> type[np.floating[Any]]:
    """Return the type of the states that follow `state` in NumPy: float32 after float32 or less, otherwise float64."""
    is_single = isinstance(state, np.ndarray) and state.dtype in (np.float16, np.float32)
    return np.float32 if is_single else np.float64


def zeros(*shape: int) -> Float[np.ndarray, " ..."]:
    """Return read-only float32 zeros that take no memory, however many a hostile file may ask for."""
    return np.broadcast_to(np.float32(0), shape)


def array_fields(module: Any) -> dict[str, Any]:
    """Return every array of an equinox module by the name of its field, which is its name in files: of a module in it, too."""
    arrays = {}
    for field in fields(module):
        value = getattr(module, field.name)
        if is_dataclass(value) and not field.metadata.get("static"):
            arrays |= {f"{field.name}.{name}": array for name, array in array_fields(value).items()}
        elif value is not None and not field.metadata.get("static"):
            arrays[field.name] = value
    return arrays


def as_parameter(numbers: ArrayLike) -> Num[AnyArray, " ..."]:
    """Return `numbers` given to a cost or a descent as float32: a JAX array if they are one, otherwise a copy."""
    if isinstance(numbers, jax.Array):
        return jnp.asarray(numbers, np.float32)
    with too_large_is_infinite():
        return np.array(numbers, np.float32)


def as_jax(numbers: ArrayLike, dtype: Any = np.float32) -> Num[Array, " ..."]:
    """Return `numbers`, of any shape, as a JAX array of the type `dtype`, converted by NumPy.

    `jnp.asarray` compiles a program for every shape it converts; this compiles nothing.
    """
    if isinstance(numbers, jax.Array):
        return jnp.asarray(numbers, dtype)
    with too_large_is_infinite():
        # A copy: JAX may keep the memory it is given, and users write into theirs.
        return jax.device_put(np.array(numbers, dtype))
