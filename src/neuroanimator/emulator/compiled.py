"""Functions of an emulator for calls from Python: compiled once per structure, and cheap to call again.

`equinox.filter_jit` flattens a module at every call, which costs milliseconds for one with a skin or
hundreds of named numbers. Here a module is flattened once, and its arrays go straight to `jax.jit`.
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

from neuroanimator.files.remembered import Remembered
from neuroanimator.state.arrays import AnyArray

PROGRAMS = 256
"""Maximum number of functions of structures that are kept compiled; each takes some megabytes."""

Leaves = tuple[Array | np.ndarray, ...]
Shapes = tuple[tuple[int, ...], ...]


class Form(NamedTuple):
    """A module without its arrays: hashable, as the key of its programs."""

    structure: Any
    others: tuple[Any, ...]
    """Leaves that are not arrays, such as a user's cost function; None in place of an array."""

    def filled(self, arrays: Leaves) -> Any:
        """Return the module with these arrays."""
        remaining = iter(arrays)
        leaves = [next(remaining) if other is None else other for other in self.others]
        return jax.tree_util.tree_unflatten(self.structure, leaves)


@dataclass(frozen=True)
class CompiledProgram:
    """A function of a module's arrays and of further arrays, compiled once for all their shapes."""

    run: Callable[..., Any]
    compiled_for: set[Shapes] = field(default_factory=set)
    """Shapes of the arrays that `Compiled.compile` compiled it for."""


class Compiled:
    """`function(module, *arrays)` for one module, by a program compiled once for the module's form and the shapes."""

    def __init__(self, function: Callable[..., Any], module: Any):
        self._leaves, form = _taken_apart(module)
        self._leaf_shapes = _shapes_of(self._leaves)
        self._program = _program(function, form)

    def __call__(self, *arrays: Any) -> Any:
        """Return the function of the module and `arrays`."""
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

    Inside a user's `jax.jit`, `grad` or `vmap` it is part of that program.
    """
    leaves, form = _taken_apart(module)
    return _program(function, form).run(leaves, *arrays)


@Remembered
def _taken_apart(module: Any) -> tuple[Leaves, Form]:
    """Return the arrays of a module and its form."""
    flat, structure = jax.tree_util.tree_flatten(module)
    leaves = tuple(leaf for leaf in flat if eqx.is_array(leaf))
    others = tuple(None if eqx.is_array(leaf) else leaf for leaf in flat)
    form = Form(structure, others)
    if is_traced(leaves):
        return leaves, form
    # Once, not at every call. Inside a user's `jax.jit` they would be part of that program, of no use to others.
    with jax.ensure_compile_time_eval():
        return tuple(jax.device_put(leaf) for leaf in leaves), form


def is_traced(module: Any) -> bool:
    """Return whether JAX is transforming any array of a module."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree_util.tree_leaves(module))


@lru_cache(maxsize=PROGRAMS)
def _program(function: Callable[..., Any], form: Form) -> CompiledProgram:
    """Return the program of `function` for modules of this form; it is compiled at the first call."""

    def run(leaves: Leaves, *arrays: Any) -> Any:
        return function(form.filled(leaves), *arrays)

    run.__name__ = getattr(function, "__name__", "run")
    # Inlined, so that it leaves no nested call inside a user's own jit.
    return CompiledProgram(jax.jit(run, inline=True))


@cache
def of_rows(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` of a module and arrays, mapped over rows of the arrays; always the same object."""

    def run_rows(module: Any, *rows: Array) -> Any:
        return jax.vmap(function, (None, *[0] * len(rows)))(module, *rows)

    return run_rows


def as_numpy(numbers: Array) -> Float[AnyArray, " ..."]:
    """Return a JAX array as a NumPy array; unchanged inside a user's `jax.jit`, `grad` or `vmap`."""
    if isinstance(numbers, jax.core.Tracer):
        return numbers
    return np.array(numbers)
