"""Functions of an emulator as Python calls them: compiled once for every structure, and cheap to call again.

`equinox.filter_jit` takes a module apart at every call, which costs milliseconds for one with a skin or
hundreds of named numbers. Here a module is taken apart once, and its arrays go straight to `jax.jit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.emulator.arrays import as_float32, is_plain
from neuroanimator.emulator.checks import (
    MAX_CONTROL,
    MAX_MAGNITUDE,
    check_motion,
    check_numbers,
)
from neuroanimator.errors import ArgumentError
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import Layout
from neuroanimator.storage.remembered import UNKNOWN, Remembered

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


def as_numpy(numbers: Array) -> Float[AnyArray, " ..."]:
    """Return an array of JAX as one of NumPy; as it is inside somebody's `jax.jit`, `grad` or `vmap`."""
    if isinstance(numbers, jax.core.Tracer):
        return numbers
    return np.array(numbers)


class Step:
    """A super step to call: from Python, and inside `jax.jit`, `jax.grad` and `jax.vmap`."""

    def __init__(
        self,
        function: Callable[..., Array],
        program_of: Callable[[Any], Any],
        emulator: Any,
    ):
        """`function` (emulator, state, control) → the next state; `program_of` (emulator) does it in C, or is None."""
        self._function = function
        self._program_of = program_of
        self._emulator = emulator
        self.__name__ = "step"
        self.__doc__ = type(self).__call__.__doc__

    def __repr__(self) -> str:
        emulator = self._emulator
        shapes = f"state ({emulator.state.size},), control ({emulator.control.size},)"
        return f"step({shapes}) of {emulator!r}"

    def __call__(self, state: ArrayLike, control: ArrayLike) -> Float[AnyArray, " S"]:
        """Return the state (S,) one super step after `state` (S,) under `control` (C,).

        Of arrays of JAX it is one of JAX, and differentiable; of all else it is one of NumPy, computed by the `backend`.

        Raises ArgumentError for wrong shapes, and of arrays that are not JAX's for what `rollout` refuses.
        """
        emulator = self._emulator
        if is_plain(state) and is_plain(control):
            program = self._program_of(emulator)
            if program is not None and program.takes_step(state, control):
                following, is_sound = program.step(as_float32(state), as_float32(control))
                if is_sound:
                    return following
        is_for_jax = isinstance(state, jax.Array) or isinstance(control, jax.Array)
        state = self._checked(state, emulator.state, "state", MAX_MAGNITUDE)
        control = self._checked(control, emulator.control, "control", MAX_CONTROL)
        if is_for_jax:
            return call_compiled(self._function, emulator, state, control)
        program = self._program_of(emulator)
        if program is None:
            following = as_numpy(call_compiled(self._function, emulator, state, control))
        else:
            following, _ = program.step(state, control)
        if not isinstance(following, jax.core.Tracer):
            check_motion(np.stack([state, following]), emulator.state)
        return following

    def _checked(self, vector: ArrayLike, layout: Layout, label: str, most: float) -> Any:
        shape = (layout.size,)
        if isinstance(vector, jax.Array) and np.shape(vector) == shape:
            return vector  # Looking at its numbers would wait for them, and a tracer has none.
        if isinstance(vector, jax.core.Tracer) or np.shape(vector) != shape:
            raise ArgumentError(
                f"{label}: wanted {shape[0]} numbers, came shape {np.shape(vector)}. "
                "For many at once use jax.vmap(emulator.step), or rollout."
            )
        dtype = self._emulator.normaliser.change_scale.dtype
        return check_numbers(vector, layout, label, most, dtype)
