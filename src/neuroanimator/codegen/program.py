"""A JAX function as a list of operations on addresses, from which source code can be written.

The function is traced, nested calls are laid open, what depends on constants alone is computed, and what nobody
needs is dropped. Values are arrays of addresses: whatever only moves data about (slices, concatenations, transposes)
is done to the addresses once and leaves no code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var

from neuroanimator.errors import NeuroAnimatorError

NESTED = ("jaxpr", "call_jaxpr", "fun_jaxpr")
"""Parameters under which an operation keeps the operations it stands for."""

MOVES = frozenset(
    ("broadcast_in_dim", "concatenate", "copy", "copy_p", "dynamic_slice", "expand_dims", "gather", "reshape", "rev",
     "slice", "split", "squeeze", "stack", "stop_gradient", "tile", "transpose", "convert_element_type")
)  # fmt: skip
"""What moves data and computes nothing. Of number types there is one here: truth is 0 or 1."""

WIDTH = 16
"""Floats to which arrays are aligned: an AVX-512 register."""

FEW = 4
"""Arrays up to this length share a line of memory: scalars, vectors and quaternions."""

Addresses = np.ndarray
"""Where each entry of a value is: from 0 on in the workspace, from -1 down among the constants."""


@dataclass(frozen=True)
class Operation:
    """One that computes: by JAX' name and parameters, on addresses."""

    name: str
    inputs: tuple[Addresses, ...]
    output: Addresses
    params: dict[str, Any]


@dataclass
class Program:
    """(inputs) → outputs by `operations`, in a workspace of floats."""

    inputs: list[Addresses] = field(default_factory=list)
    outputs: list[Addresses] = field(default_factory=list)
    operations: list[Operation] = field(default_factory=list)
    constants: list[np.ndarray] = field(default_factory=list)
    """Float32 blocks, one behind the other."""
    starts: list[int] = field(default_factory=lambda: [0])
    """Where each block begins, and where the next one will."""
    size: int = 0
    """Floats in the workspace."""
    _free: int = 0
    """Where the next few numbers go, up to the end of their line."""
    _line_end: int = 0

    def room(self, shape: tuple[int, ...]) -> Addresses:
        """Return fresh addresses of this shape: aligned, with room for whole registers, unless they are few."""
        count = math.prod(shape)
        if count > FEW:
            first, self.size = self.size, self.size + -(-count // WIDTH) * WIDTH
        else:
            if self._free + count > self._line_end:
                self._free, self.size = self.size, self.size + WIDTH
                self._line_end = self.size
            first, self._free = self._free, self._free + count
        return first + np.arange(count).reshape(shape)

    def constant(self, numbers: np.ndarray) -> Addresses:
        """Return the addresses of these numbers among the constants."""
        first = self.starts[-1]
        self.constants.append(np.asarray(numbers, np.float32).ravel())
        self.starts.append(first + max(numbers.size, 1))
        return -(first + np.arange(numbers.size).reshape(numbers.shape)) - 1

    def value_of(self, addresses: Addresses) -> np.ndarray:
        """Return the constants at `addresses`, all of which must be constants."""
        return np.concatenate(self.constants)[-addresses - 1]


def trace(function: Callable[..., Any], *shapes: tuple[int, ...]) -> Program:
    """Return the program of `function`, which takes float32 arrays of these shapes and returns one array.

    Raises UnsupportedError for what cannot be laid open beforehand, such as entries whose place is computed. Of loops
    and branches the writer says that it knows no code for them.
    """
    closed = jax.make_jaxpr(function)(*(jnp.zeros(shape, jnp.float32) for shape in shapes))
    return _Tracer().run(closed, shapes)


class UnsupportedError(NeuroAnimatorError):
    """An operation of JAX no code can be written for."""

    def __init__(self, name: str):
        super().__init__(f"No code can be written for JAX' operation '{name}'.")


class _Tracer:
    def __init__(self) -> None:
        self.program = Program()

    def run(self, closed: ClosedJaxpr, shapes: tuple[tuple[int, ...], ...]) -> Program:
        program = self.program
        program.inputs = [program.room(shape) for shape in shapes]
        found = self._jaxpr(
            closed.jaxpr, [np.asarray(const) for const in closed.consts], list(program.inputs)
        )
        program.outputs = [self._addresses(each) for each in found]
        program.operations = list(_needed(program))
        return program

    def _jaxpr(self, jaxpr: Jaxpr, consts: list[Any], inputs: list[Any]) -> list[Any]:
        """Return the outputs; values are Addresses, or _Known."""
        known: dict[Var, Any] = dict(zip(jaxpr.constvars, map(_wrap, consts), strict=True))
        known |= dict(zip(jaxpr.invars, inputs, strict=True))

        def read(atom):
            return _Known(np.asarray(atom.val)) if isinstance(atom, Literal) else known[atom]

        for eqn in jaxpr.eqns:
            known |= dict(
                zip(
                    eqn.outvars,
                    self._equation(eqn, [read(atom) for atom in eqn.invars]),
                    strict=True,
                )
            )
        return [read(atom) for atom in jaxpr.outvars]

    def _equation(self, eqn: JaxprEqn, inputs: list[Any]) -> list[Any]:
        latent = next((eqn.params[key] for key in NESTED if key in eqn.params), None)
        if latent is not None and eqn.primitive.name not in ("scan", "while", "cond"):
            is_closed = isinstance(latent, ClosedJaxpr)
            return self._jaxpr(
                latent.jaxpr if is_closed else latent,
                list(latent.consts) if is_closed else [],
                inputs,
            )
        if all(isinstance(each, _Known) for each in inputs):
            return [
                _Known(np.asarray(each)) for each in _bind(eqn, [each.numbers for each in inputs])
            ]
        if eqn.primitive.name in MOVES:
            return self._moved(eqn, inputs)
        return [self._computed(eqn, inputs)]

    def _moved(self, eqn: JaxprEqn, inputs: list[Any]) -> list[Any]:
        """Do to the addresses what is done to the data; which entries are moved where, constants say."""
        name = eqn.primitive.name
        if name == "convert_element_type":
            before, after = eqn.invars[0].aval.dtype, eqn.outvars[0].aval.dtype
            if before.kind == "f" and after.kind != "f":
                raise UnsupportedError(f"{name} from {before} to {after}")
            return inputs
        moved = 1 if name in ("gather", "dynamic_slice") else len(inputs)
        if not all(isinstance(each, _Known) for each in inputs[moved:]):
            raise UnsupportedError(f"{name} at places that are computed")
        positions = [jnp.asarray(self._addresses(each), jnp.int32) for each in inputs[:moved]]
        rest = [jnp.asarray(each.numbers) for each in inputs[moved:]]
        return [np.asarray(each, int) for each in _bind(eqn, [*positions, *rest])]

    def _computed(self, eqn: JaxprEqn, inputs: list[Any]) -> Addresses:
        output = self.program.room(eqn.outvars[0].aval.shape)
        addresses = tuple(self._addresses(each) for each in inputs)
        self.program.operations.append(Operation(eqn.primitive.name, addresses, output, eqn.params))
        return output

    def _addresses(self, value: Any) -> Addresses:
        return self.program.constant(value.numbers) if isinstance(value, _Known) else value


@dataclass(frozen=True)
class _Known:
    numbers: np.ndarray


def _wrap(numbers: Any) -> _Known:
    return _Known(np.asarray(numbers))


def _bind(eqn: JaxprEqn, inputs: list[Any]) -> list[Any]:
    found = eqn.primitive.bind(*map(jnp.asarray, inputs), **eqn.params)
    return list(found) if eqn.primitive.multiple_results else [found]


def _needed(program: Program) -> Iterator[Operation]:
    """Yield the operations that outputs depend on, in order."""
    needed = np.zeros(program.size, bool)
    for output in program.outputs:
        needed[output[output >= 0]] = True
    kept = []
    for operation in reversed(program.operations):
        if needed[operation.output].any():
            kept.append(operation)
            for each in operation.inputs:
                needed[each[each >= 0]] = True
    yield from reversed(kept)
