"""From a JAX function to a `Program`: nested calls are inlined, constant subexpressions computed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.extend.core as jaxprs
import jax.numpy as jnp
import numpy as np

from neuroanimator.codegen.program import (
    EARLY,
    LATE,
    WIDE,
    Addresses,
    Constants,
    Operation,
    Program,
)
from neuroanimator.errors import NeuroAnimatorError

NESTED = ("jaxpr", "call_jaxpr", "fun_jaxpr")
"""Parameters in which an operation holds its nested operations."""

LOOPS_AND_BRANCHES = ("scan", "while", "cond")
"""Operations whose nested ones are not executed exactly once, and so cannot be inlined."""


LARGEST_EIGEN = 8
"""Maximum number of rows of a matrix whose eigenvectors can be found."""


class UnsupportedError(NeuroAnimatorError):
    """An operation of JAX for which no code can be written."""

    def __init__(self, name: str):
        super().__init__(f"No code can be generated for the JAX operation '{name}'.")


class TooLongError(NeuroAnimatorError):
    """A function of so much C that it takes longer to compile than to run without."""

    def __init__(self, size: int):
        super().__init__(f"Its C would be {size / 1e6:.1f} MB long.")


class Input(NamedTuple):
    """One argument of a function to trace."""

    shape: tuple[int, ...]
    is_wide: bool = False
    """Whether each lane has its own values."""
    is_late: bool = False
    """Whether it is a cotangent or a tangent, known only after everything early."""
    dtype: type[np.floating] = np.float32
    """Precision in which JAX traces it; addresses have none."""

    @property
    def space(self) -> int:
        """Space of its numbers."""
        return (LATE if self.is_late else EARLY) | (WIDE if self.is_wide else 0)


def trace(
    function: Callable[..., Any], module: Any, *inputs: Input, constants: Constants | None = None
) -> Program:
    """Return the program of `function`, which takes `module` and arrays and returns an array or a tuple of arrays.

    The arrays of `module` (any pytree: an emulator, an objective) are the program's constants.

    Raises UnsupportedError for loops and branches, and for what cannot be resolved in advance, such as entries whose
    position is computed.
    """
    arguments = [jax.ShapeDtypeStruct(entry.shape, entry.dtype) for entry in inputs]
    closed = jax.make_jaxpr(function)(module, *arguments)
    program = Program(Constants() if constants is None else constants)
    program.inputs = [program.room(entry.shape, entry.space) for entry in inputs]
    weights = [_Known(np.asarray(leaf), False) for leaf in jax.tree.leaves(module)]
    _Tracer(program).run(closed, weights)
    program.keep_needed()
    if any(entry.is_late for entry in inputs):
        program.keep_tape()
    return program


def nested_jaxpr(eqn: jaxprs.JaxprEqn) -> Any:
    """Return the operations nested in an operation; None if there are none."""
    return next((eqn.params[key] for key in NESTED if key in eqn.params), None)


def constant_array(constant: Any) -> np.ndarray:
    """Return a constant of a traced function; UnsupportedError for random keys, which are not numbers."""
    if jnp.issubdtype(constant.dtype, jax.dtypes.extended):
        raise UnsupportedError("random_bits")
    return np.asarray(constant)


def evaluated(
    jaxpr: jaxprs.Jaxpr,
    inputs: list[Any],
    literal: Callable[[Any], Any],
    apply: Callable[[jaxprs.JaxprEqn, list[Any]], list[Any]],
) -> list[Any]:
    """Return the outputs of `jaxpr` for its constants and `inputs`, whose operations `apply` does on values of any kind."""
    values: dict[jaxprs.Var, Any] = dict(
        zip([*jaxpr.constvars, *jaxpr.invars], inputs, strict=True)
    )

    def read(atom: Any) -> Any:
        return literal(atom.val) if isinstance(atom, jaxprs.Literal) else values[atom]

    for eqn in jaxpr.eqns:
        results = apply(eqn, [read(atom) for atom in eqn.invars])
        values.update(zip(eqn.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


@dataclass(frozen=True)
class _Known:
    """A value that is known before the program runs."""

    numbers: np.ndarray
    is_literal: bool
    """Whether it follows from the definition alone, whatever the weights."""

    @classmethod
    def literal(cls, value: Any) -> _Known:
        """Return a number of the definition."""
        return cls(np.asarray(value), True)


class _Tracer:
    """Walks through a jaxpr and collects its operations in a program."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self._results: dict[tuple[Any, ...], Addresses] = {}
        """Address of each operation's result, so that the same operation is not computed twice."""
        self._special: dict[str, Callable[[jaxprs.JaxprEqn, list[Any]], list[Any]]] = {
            "convert_element_type": self._converted,
            "dynamic_slice": self._picked,
            "dynamic_update_slice": self._scattered,
            "eigh": self._eigen,
            "gather": self._picked,
            "pad": self._padded,
            "scatter": self._scattered,
            "scatter-add": self._scattered,
            "select_n": self._selected,
        }

    def run(self, closed: jaxprs.ClosedJaxpr, weights: list[_Known]) -> None:
        outputs = self._outputs(closed, [*weights, *self.program.inputs])
        self.program.outputs = [self._addresses(output) for output in outputs]

    def _outputs(self, jaxpr: jaxprs.ClosedJaxpr | jaxprs.Jaxpr, inputs: list[Any]) -> list[Any]:
        """Return the outputs; values are Addresses or _Known."""
        if isinstance(jaxpr, jaxprs.ClosedJaxpr):
            constants = [_Known(constant_array(constant), False) for constant in jaxpr.consts]
            return self._outputs(jaxpr.jaxpr, [*constants, *inputs])
        return evaluated(jaxpr, inputs, _Known.literal, self._equation)

    def _equation(self, eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Any]:
        name = eqn.primitive.name
        inner = nested_jaxpr(eqn)
        if inner is not None and name not in LOOPS_AND_BRANCHES:
            return self._outputs(inner, inputs)
        if all(isinstance(operand, _Known) for operand in inputs):
            is_literal = all(operand.is_literal for operand in inputs)
            numbers = [operand.numbers for operand in inputs]
            results = _results_now(eqn, numbers)
            return [_Known(constant_array(result), is_literal) for result in results]
        if name in MOVES:
            addresses = [self._addresses(operand) for operand in inputs]
            return [np.asarray(result) for result in MOVES[name](addresses, eqn.params)]
        special = self._special.get(name)
        if special is not None:
            return special(eqn, inputs)
        if eqn.primitive.multiple_results:
            raise UnsupportedError(name)
        return [self._computed(eqn, inputs)]

    def _converted(self, eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Addresses]:
        """Return the same numbers: there is only one type, and booleans are 0 or 1."""
        before = eqn.invars[0].aval.dtype
        after = eqn.outvars[0].aval.dtype
        if before.kind == "f" and after.kind != "f":
            raise UnsupportedError(f"convert_element_type from {before} to {after}")
        return inputs

    def _picked(self, eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Any]:
        """Return the entries of the first input at indices, which must be known."""
        source, *indices = inputs
        if not all(isinstance(operand, _Known) for operand in indices):
            raise UnsupportedError(f"{eqn.primitive.name} at computed indices")
        addresses = self._addresses(source)
        # JAX picks from positions, which are small integers; its fill value is beyond the last.
        positions = np.arange(addresses.size, dtype=np.int32).reshape(addresses.shape)
        picked = _bind(eqn, [positions, *(operand.numbers for operand in indices)])[0]
        flat = np.append(addresses.ravel(), self.program.constants.literal(0.0))
        chosen = np.asarray(picked)
        is_inside = (chosen >= 0) & (chosen < addresses.size)
        return [np.asarray(flat[np.where(is_inside, chosen, addresses.size)])]

    def _selected(self, eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Addresses]:
        """Return the selected entries, already resolved if the selector is known."""
        which, *cases = inputs
        if not isinstance(which, _Known):
            return [self._computed(eqn, inputs)]
        entries = np.stack([self._addresses(case) for case in cases])
        number = np.broadcast_to(which.numbers.astype(int), entries.shape[1:])
        return [np.take_along_axis(entries, number[None], axis=0)[0]]

    def _padded(self, eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Addresses]:
        source = self._addresses(inputs[0])
        filling = self._addresses(inputs[1])
        inside = []
        within = []
        shape = []
        for size, (low, high, between) in zip(
            source.shape, eqn.params["padding_config"], strict=True
        ):
            places = low + np.arange(size) * (between + 1)
            length = max(0, low + high + size + max(0, size - 1) * between)
            is_inside = (places >= 0) & (places < length)
            inside.append(places[is_inside])
            within.append(np.flatnonzero(is_inside))
            shape.append(length)
        padded = np.full(shape, int(filling.flat[0]))
        padded[np.ix_(*inside)] = source[np.ix_(*within)]
        return [padded]

    def _scattered(self, eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Addresses]:
        """Return the first input with entries replaced by, or added to, those of the updates."""
        name = eqn.primitive.name
        operand = self._addresses(inputs[0])
        if name == "dynamic_update_slice":
            updates = self._addresses(inputs[1])
            indices = inputs[2:]
        else:
            updates = self._addresses(inputs[2])
            indices = inputs[1:2]
        if not all(isinstance(index, _Known) for index in indices):
            raise UnsupportedError(f"{name} at computed indices")
        result = operand.ravel().copy()
        where = _targets(eqn, operand, updates, [index.numbers for index in indices]).ravel()
        pending = np.flatnonzero(where >= 0)
        while len(pending):
            # Several updates of one entry are applied one after another.
            _, first = np.unique(where[pending], return_index=True)
            now = pending[first]
            target = where[now]
            if name == "scatter-add":
                result[target] = self._operation(
                    "add", (result[target], updates.ravel()[now]), (len(now),), {}
                )
            else:
                result[target] = updates.ravel()[now]
            pending = np.delete(pending, first)
        return [result.reshape(operand.shape)]

    def _eigen(self, eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Addresses]:
        """Return the eigenvectors (N, N), columns, and the eigenvalues (N,) of one symmetric matrix."""
        (matrix,) = inputs
        size = matrix.shape[-1]
        if matrix.shape != (size, size) or size > LARGEST_EIGEN:
            raise UnsupportedError(f"eigh of an array of shape {matrix.shape}")
        output = self._operation("eigh", (matrix,), (size * (size + 1),), eqn.params)
        return [output[: size * size].reshape(size, size), output[size * size :]]

    def _computed(self, eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> Addresses:
        addresses = tuple(self._addresses(operand) for operand in inputs)
        return self._operation(eqn.primitive.name, addresses, eqn.outvars[0].aval.shape, eqn.params)

    def _operation(
        self,
        name: str,
        inputs: tuple[Addresses, ...],
        shape: tuple[int, ...],
        params: dict[str, Any],
    ) -> Addresses:
        """Return the result's addresses: new ones for entries that must be computed, existing ones for others."""
        if not math.prod(shape):
            return np.zeros(shape, int)
        if name in OF_NOTHING and not inputs[0].size:
            return np.full(shape, self.program.constants.literal(OF_NOTHING[name]))
        if name not in SIMPLE:
            return self._result(name, inputs, shape, params)
        columns = [np.broadcast_to(addresses, shape).ravel() for addresses in inputs]
        literals = self.program.constants
        result = SIMPLE[name](*columns, literals.literal(0.0), literals.literal(1.0))
        rest = np.flatnonzero(result == COMPUTE)
        if len(rest) == len(result):
            rest = slice(None)
        elif not len(rest):
            return result.reshape(shape)
        inputs = tuple(column[rest] for column in columns)
        result[rest] = self._result(name, inputs, inputs[0].shape, params)
        return result.reshape(shape)

    def _result(
        self,
        name: str,
        inputs: tuple[Addresses, ...],
        shape: tuple[int, ...],
        params: dict[str, Any],
    ) -> Addresses:
        """Return the addresses of an operation's result; existing ones if the same operation was traced before."""
        operands = [(entry.shape, entry.tobytes()) for entry in inputs]
        key = (name, *operands, shape, str(params))
        if key not in self._results:
            self._results[key] = self.program.room_for_result(shape, inputs)
            operation = Operation(name, inputs, self._results[key], params)
            self.program.operations.append(operation)
        return self._results[key]

    def _addresses(self, value: Any) -> Addresses:
        if not isinstance(value, _Known):
            return value
        if value.is_literal:
            return self.program.constants.literal_array(value.numbers)
        return self.program.constants.add(value.numbers)


OF_NOTHING = {
    "reduce_sum": 0.0,
    "reduce_max": -math.inf,
    "reduce_min": math.inf,
    "reduce_and": 1.0,
    "reduce_or": 0.0,
    "dot_general": 0.0,
}
"""Results of reductions over no numbers."""

COMPUTE = np.iinfo(np.int64).max
"""Stands for an address that is yet to be computed."""


def _product(left: Addresses, right: Addresses, zero: int, one: int) -> Addresses:
    result = np.where(right == one, left, np.where(left == one, right, COMPUTE))
    return np.where((left == zero) | (right == zero), zero, result)


def _sum(left: Addresses, right: Addresses, zero: int, one: int) -> Addresses:
    return np.where(right == zero, left, np.where(left == zero, right, COMPUTE))


SIMPLE: dict[str, Callable[..., Addresses]] = {
    "add": _sum,
    "add_any": _sum,
    "sub": lambda left, right, zero, one: np.where(right == zero, left, COMPUTE),
    "mul": _product,
    "div": lambda left, right, zero, one: np.where(
        left == zero, zero, np.where(right == one, left, COMPUTE)
    ),
    "neg": lambda number, zero, one: np.where(number == zero, zero, COMPUTE),
}
"""Operations that need no code where an input is a literal zero or one: gradients are full of them."""


def _targets(
    eqn: jaxprs.JaxprEqn, operand: Addresses, updates: Addresses, indices: list[np.ndarray]
) -> np.ndarray:
    """Return the flat index into `operand` that each of `updates` goes to; -1 for none."""
    positions = np.arange(operand.size, dtype=np.int32).reshape(operand.shape)
    if eqn.primitive.name == "dynamic_update_slice":
        return np.asarray(jax.lax.dynamic_slice(positions, indices, updates.shape))
    numbers = eqn.params["dimension_numbers"]
    batching = (*numbers.inserted_window_dims, *numbers.operand_batching_dims)
    windows = iter(numbers.update_window_dims)
    sizes = []
    for axis in range(operand.ndim):
        sizes.append(1 if axis in batching else updates.shape[next(windows)])
    where = jax.lax.gather(
        positions,
        indices[0],
        jax.lax.GatherDimensionNumbers(
            offset_dims=numbers.update_window_dims,
            collapsed_slice_dims=numbers.inserted_window_dims,
            start_index_map=numbers.scatter_dims_to_operand_dims,
            operand_batching_dims=numbers.operand_batching_dims,
            start_indices_batching_dims=numbers.scatter_indices_batching_dims,
        ),
        tuple(sizes),
        mode=jax.lax.GatherScatterMode.FILL_OR_DROP,
        fill_value=-1,
    )
    return np.asarray(where)


def _results_now(eqn: jaxprs.JaxprEqn, inputs: list[np.ndarray]) -> list[Any]:
    """Return the results of an operation on numbers: by NumPy if they are exactly JAX's, which compiles a program for each."""
    name = eqn.primitive.name
    if name in MOVES:
        return MOVES[name](inputs, eqn.params)
    dtype = eqn.outvars[0].aval.dtype
    if name == "iota":
        shape = eqn.params["shape"]
        along = np.arange(shape[eqn.params["dimension"]], dtype=dtype)
        return _broadcast(
            [along], eqn.params | {"broadcast_dimensions": (eqn.params["dimension"],)}
        )
    if name == "convert_element_type" and not (inputs[0].dtype.kind == "f" and dtype.kind in "iu"):
        return [inputs[0].astype(dtype)]
    # Whole numbers are divided towards zero.
    if name in EXACT and not (name == "div" and dtype.kind in "iu"):
        with np.errstate(all="ignore"):
            return [EXACT[name](*inputs).astype(dtype)]
    return _bind(eqn, inputs)


EXACT: dict[str, Callable[..., np.ndarray]] = {
    "add": np.add,
    "add_any": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "max": np.maximum,
    "min": np.minimum,
    "sqrt": np.sqrt,
    "square": np.square,
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "select_n": lambda which, *cases: np.choose(which.astype(int), cases),
}
"""Operations that round as JAX does; only JAX makes zeros of numbers below 1e-38."""


def _bind(eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Any]:
    """Return the results of an operation on `inputs`, executed now."""
    # `jnp.asarray` would compile a program for every shape.
    return bound(eqn, jax.device_put(inputs))


def bound(eqn: jaxprs.JaxprEqn, inputs: list[Any]) -> list[Any]:
    """Return the results of an operation on JAX arrays."""
    results = eqn.primitive.bind(*inputs, **eqn.params)
    if eqn.primitive.multiple_results:
        return list(results)
    return [results]


def _broadcast(inputs: list[Addresses], params: dict[str, Any]) -> list[Addresses]:
    shape = [1] * len(params["shape"])
    for axis, size in zip(params["broadcast_dimensions"], inputs[0].shape, strict=True):
        shape[axis] = size
    return [np.broadcast_to(inputs[0].reshape(shape), params["shape"])]


def _reshaped(inputs: list[Addresses], params: dict[str, Any]) -> list[Addresses]:
    if params.get("dimensions") is not None:
        raise UnsupportedError("reshape of transposed axes")
    return [inputs[0].reshape(params["new_sizes"])]


def _sliced(inputs: list[Addresses], params: dict[str, Any]) -> list[Addresses]:
    steps = params["strides"] or (1,) * inputs[0].ndim
    ends = zip(params["start_indices"], params["limit_indices"], steps, strict=True)
    return [inputs[0][tuple(slice(first, last, step) for first, last, step in ends)]]


def _unstacked(inputs: list[Addresses], params: dict[str, Any]) -> list[Addresses]:
    parts = np.moveaxis(inputs[0], params["axis"], 0)
    return [np.asarray(part) for part in parts]  # NumPy turns a vector's parts into scalars


MOVES: dict[str, Callable[[list[Addresses], dict[str, Any]], list[Addresses]]] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda inputs, params: [np.concatenate(inputs, axis=params["dimension"])],
    "copy": lambda inputs, params: inputs,
    "copy_p": lambda inputs, params: inputs,
    "expand_dims": lambda inputs, params: [np.expand_dims(inputs[0], params["dimensions"])],
    "reshape": _reshaped,
    "rev": lambda inputs, params: [np.flip(inputs[0], params["dimensions"])],
    "slice": _sliced,
    "split": lambda inputs, params: np.split(
        inputs[0], np.cumsum(params["sizes"])[:-1], axis=params["axis"]
    ),
    "squeeze": lambda inputs, params: [np.squeeze(inputs[0], axis=tuple(params["dimensions"]))],
    "stack": lambda inputs, params: [np.stack(inputs, axis=params["axis"])],
    "stop_gradient": lambda inputs, params: inputs,
    "tile": lambda inputs, params: [np.tile(inputs[0], params["reps"])],
    "transpose": lambda inputs, params: [np.transpose(inputs[0], params["permutation"])],
    "unstack": _unstacked,
}
"""Operations that only move data, applied to the addresses."""
