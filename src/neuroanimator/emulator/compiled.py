"""Functions of an emulator as Python calls them: compiled once for every structure, and cheap to call again.

`equinox.filter_jit` takes a module apart at every call, which costs milliseconds for one with a skin or
hundreds of named numbers. Here a module is taken apart once, and its arrays go straight to `jax.jit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.files.remembered import UNKNOWN, Remembered
from neuroanimator.state.arrays import AnyArray

PROGRAMS = 256
"""Functions of structures that are kept compiled; each takes some megabytes."""

Leaves = tuple[Array | np.ndarray, ...]
Shapes = tuple[tuple[int, ...], ...]


class Form(NamedTuple):
    """A module without its arrays: hashable, so that its programs are found by it again."""

    structure: Any
    others: tuple[Any, ...]
    """Leaves that are no arrays, such as a user's cost function; None where an array is."""

    def filled(self, arrays: Leaves) -> Any:
        """Return the module with these arrays."""
        remaining = iter(arrays)
        leaves = [next(remaining) if other is None else other for other in self.others]
        return jax.tree_util.tree_unflatten(self.structure, leaves)


@dataclass(frozen=True)
class Program:
    """A function of a module's arrays and of further arrays, compiled once for all their shapes."""

    run: Callable[..., Any]
    compiled_for: set[Shapes] = field(default_factory=set)
    """Shapes of all arrays it was compiled for with `Compiled.compile`."""


_known: Remembered[tuple[Leaves, Form]] = Remembered()
"""The arrays and the form of each module."""


class Compiled:
    """`function(module, *arrays)` for one module, by a program compiled once for the module's form and all shapes."""

    def __init__(self, function: Callable[..., Any], module: Any):
        self._leaves, form = _taken_apart(module)
        self._leaf_shapes = _shapes_of(self._leaves)
        self._program = _program(function, form)

    def __call__(self, *arrays: Any) -> Any:
        """Return what the function does."""
        return self._program.run(self._leaves, *arrays)

    def is_compiled_for(self, *arrays: Any) -> bool:
        """Return whether `compile` was called for arrays of these shapes."""
        return self._leaf_shapes + _shapes_of(arrays) in self._program.compiled_for

    def compile(self, *arrays: Any) -> None:
        """Compile for arrays of these shapes, by calling it once."""
        jax.block_until_ready(self(*arrays))
        self._program.compiled_for.add(self._leaf_shapes + _shapes_of(arrays))


def _shapes_of(arrays: Leaves) -> Shapes:
    return tuple(np.shape(array) for array in arrays)


def call_compiled(function: Callable[..., Any], module: Any, *arrays: Any) -> Any:
    """Return `function(module, *arrays)` by a program compiled once for the module's form and the arrays' shapes.

    Inside somebody else's `jax.jit`, `grad` or `vmap` it is part of their program.
    """
    leaves, form = _taken_apart(module)
    return _program(function, form).run(leaves, *arrays)


def _taken_apart(module: Any) -> tuple[Leaves, Form]:
    """Return the arrays of a module and its form; remembered as long as the module lives."""
    known = _known.of(module)
    if known is not UNKNOWN:
        return known
    flat, structure = jax.tree_util.tree_flatten(module)
    leaves = tuple(leaf for leaf in flat if eqx.is_array(leaf))
    others = tuple(None if eqx.is_array(leaf) else leaf for leaf in flat)
    form = Form(structure, others)
    if is_traced(leaves):
        return leaves, form
    # Once, not at every call. Inside somebody's `jax.jit` they would be part of that program, and of no use to others.
    with jax.ensure_compile_time_eval():
        on_device = tuple(jax.device_put(leaf) for leaf in leaves)
    return _known.keep((on_device, form), module)


def is_traced(module: Any) -> bool:
    """Return whether JAX is transforming any array of a module."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree_util.tree_leaves(module))


@lru_cache(maxsize=PROGRAMS)
def _program(function: Callable[..., Any], form: Form) -> Program:
    """Return the program of `function` for modules of that form; it is compiled at the first call."""

    def run(leaves: Leaves, *arrays: Any) -> Any:
        return function(form.filled(leaves), *arrays)

    run.__name__ = getattr(function, "__name__", "run")
    # Inlined: inside a user's own jit it leaves no call behind that others would have to understand.
    return Program(jax.jit(run, inline=True))


@cache
def of_rows(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function`, of a module and arrays, as one of rows of these arrays: always the same one."""

    def run_rows(module: Any, *rows: Array) -> Any:
        return jax.vmap(function, (None, *[0] * len(rows)))(module, *rows)

    return run_rows


def as_numpy(numbers: Array) -> Float[AnyArray, " ..."]:
    """Return an array of JAX as one of NumPy; as it is inside somebody's `jax.jit`, `grad` or `vmap`."""
    if isinstance(numbers, jax.core.Tracer):
        return numbers
    return np.array(numbers)
