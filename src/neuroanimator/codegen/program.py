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
from numpy.typing import ArrayLike

from neuroanimator.errors import NeuroAnimatorError

NESTED = ("jaxpr", "call_jaxpr", "fun_jaxpr")
"""Parameters under which an operation keeps the operations it stands for."""

LOOPS_AND_BRANCHES = ("scan", "while", "cond")
"""Operations whose nested ones are not carried out once each, and so cannot be laid open."""

MOVES = frozenset(
    ("broadcast_in_dim", "concatenate", "copy", "copy_p", "dynamic_slice", "expand_dims", "gather", "reshape", "rev",
     "slice", "split", "squeeze", "stack", "stop_gradient", "tile", "transpose", "convert_element_type")
)  # fmt: skip
"""What moves data and computes nothing. Of number types there is one here: truth is 0 or 1."""

WIDTH = 16
"""Floats to which arrays are aligned: an AVX-512 register."""

FLOAT_BYTES = 4
"""Bytes of a float32."""

ALIGNMENT = FLOAT_BYTES * WIDTH
"""Bytes to which arrays are aligned."""

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
    """Where the next few numbers go."""
    _line_end: int = 0
    """Where that line ends."""

    def room(self, shape: tuple[int, ...]) -> Addresses:
        """Return fresh addresses of this shape: aligned, with room for whole registers, unless they are few."""
        count = math.prod(shape)
        if count > FEW:
            registers = -(-count // WIDTH)
            first = self.size
            self.size += registers * WIDTH
        else:
            if self._free + count > self._line_end:
                self._free = self.size
                self.size += WIDTH
                self._line_end = self.size
            first = self._free
            self._free += count
        return np.asarray(first + np.arange(count).reshape(shape))

    def constant(self, numbers: ArrayLike) -> Addresses:
        """Return the addresses of these numbers among the constants, in their shape."""
        block = np.asarray(numbers, np.float32)
        first = self.starts[-1]
        self.constants.append(block.ravel())
        self.starts.append(first + max(block.size, 1))
        return np.asarray(-(first + np.arange(block.size).reshape(block.shape)) - 1)

    def value_of(self, addresses: Addresses) -> np.ndarray:
        """Return the constants at `addresses`, all of which must be constants."""
        return np.asarray(np.concatenate(self.constants)[-addresses - 1])


def trace(function: Callable[..., Any], *shapes: tuple[int, ...]) -> Program:
    """Return the program of `function`, which takes float32 arrays of these shapes and returns one array.

    Raises UnsupportedError for what cannot be laid open beforehand, such as entries whose position is computed. Of loops
    and branches the writer says that it knows no code for them.
    """
    zeros = [jnp.zeros(shape, jnp.float32) for shape in shapes]
    closed = jax.make_jaxpr(function)(*zeros)
    return _Tracer().run(closed, shapes)


class UnsupportedError(NeuroAnimatorError):
    """An operation of JAX no code can be written for."""

    def __init__(self, name: str):
        super().__init__(f"No code can be written for JAX' operation '{name}'.")


class _Tracer:
    """Walks through a jaxpr and gathers its operations in a program."""

    def __init__(self) -> None:
        self.program = Program()

    def run(self, closed: ClosedJaxpr, shapes: tuple[tuple[int, ...], ...]) -> Program:
        program = self.program
        program.inputs = [program.room(shape) for shape in shapes]
        constants = [np.asarray(constant) for constant in closed.consts]
        outputs = self._jaxpr(closed.jaxpr, constants, list(program.inputs))
        program.outputs = [self._addresses(output) for output in outputs]
        program.operations = list(_needed(program))
        return program

    def _jaxpr(self, jaxpr: Jaxpr, consts: list[Any], inputs: list[Any]) -> list[Any]:
        """Return the outputs; values are Addresses, or _Known."""
        known: dict[Var, Any] = dict(zip(jaxpr.constvars, map(_wrap, consts), strict=True))
        known |= dict(zip(jaxpr.invars, inputs, strict=True))

        def read(atom: Any) -> Any:
            if isinstance(atom, Literal):
                return _Known(np.asarray(atom.val))
            return known[atom]

        for eqn in jaxpr.eqns:
            operands = [read(atom) for atom in eqn.invars]
            results = self._equation(eqn, operands)
            known.update(zip(eqn.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def _equation(self, eqn: JaxprEqn, inputs: list[Any]) -> list[Any]:
        inner = next((eqn.params[key] for key in NESTED if key in eqn.params), None)
        if inner is not None and eqn.primitive.name not in LOOPS_AND_BRANCHES:
            if isinstance(inner, ClosedJaxpr):
                return self._jaxpr(inner.jaxpr, list(inner.consts), inputs)
            return self._jaxpr(inner, [], inputs)
        if all(isinstance(operand, _Known) for operand in inputs):
            results = _bind(eqn, [operand.numbers for operand in inputs])
            return [_wrap(result) for result in results]
        if eqn.primitive.name in MOVES:
            return self._moved(eqn, inputs)
        return [self._computed(eqn, inputs)]

    def _moved(self, eqn: JaxprEqn, inputs: list[Any]) -> list[Any]:
        """Do to the addresses what is done to the data; which entries are moved where, constants say."""
        name = eqn.primitive.name
        if name == "convert_element_type":
            before = eqn.invars[0].aval.dtype
            after = eqn.outvars[0].aval.dtype
            if before.kind == "f" and after.kind != "f":
                raise UnsupportedError(f"{name} from {before} to {after}")
            return inputs
        # Of these two the first input is moved; the others say from where.
        count = 1 if name in ("gather", "dynamic_slice") else len(inputs)
        moved = inputs[:count]
        indices = inputs[count:]
        if not all(isinstance(operand, _Known) for operand in indices):
            raise UnsupportedError(f"{name} at places that are computed")
        addresses = [jnp.asarray(self._addresses(operand), jnp.int32) for operand in moved]
        numbers = [jnp.asarray(operand.numbers) for operand in indices]
        results = _bind(eqn, [*addresses, *numbers])
        return [np.asarray(result, int) for result in results]

    def _computed(self, eqn: JaxprEqn, inputs: list[Any]) -> Addresses:
        output = self.program.room(eqn.outvars[0].aval.shape)
        addresses = tuple(self._addresses(operand) for operand in inputs)
        self.program.operations.append(Operation(eqn.primitive.name, addresses, output, eqn.params))
        return output

    def _addresses(self, value: Any) -> Addresses:
        if isinstance(value, _Known):
            return self.program.constant(value.numbers)
        return value


@dataclass(frozen=True)
class _Known:
    """A value that is known before the program runs."""

    numbers: np.ndarray


def _wrap(numbers: Any) -> _Known:
    return _Known(np.asarray(numbers))


def _bind(eqn: JaxprEqn, inputs: list[Any]) -> list[Any]:
    """Return what an operation gives for `inputs`, carried out now."""
    results = eqn.primitive.bind(*map(jnp.asarray, inputs), **eqn.params)
    if eqn.primitive.multiple_results:
        return list(results)
    return [results]


def _needed(program: Program) -> Iterator[Operation]:
    """Yield the operations that outputs depend on, in order."""
    needed = np.zeros(program.size, bool)
    for output in program.outputs:
        needed[output[output >= 0]] = True
    backwards = []
    for operation in reversed(program.operations):
        if needed[operation.output].any():
            backwards.append(operation)
            for addresses in operation.inputs:
                needed[addresses[addresses >= 0]] = True
    yield from reversed(backwards)
