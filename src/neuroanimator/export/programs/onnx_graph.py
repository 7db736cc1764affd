"""A definition in JAX as a graph of ONNX operators, for many examples at once.

Every tensor is (batch, N): operations that only move numbers within an example choose columns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from neuroanimator.codegen.decompositions import without_decompositions
from neuroanimator.codegen.program import Addresses, Operation, Program
from neuroanimator.codegen.trace import Input, UnsupportedError, trace
from neuroanimator.export.programs.definition import ProgramDefinition
from neuroanimator.files.atomic import Tensors

OPERATORS = {
    "neg": "Neg", "sqrt": "Sqrt", "exp": "Exp", "log": "Log", "tanh": "Tanh", "logistic": "Sigmoid", "sin": "Sin",
    "cos": "Cos", "tan": "Tan", "asin": "Asin", "acos": "Acos", "atan": "Atan", "sinh": "Sinh", "cosh": "Cosh",
    "abs": "Abs", "sign": "Sign", "floor": "Floor", "ceil": "Ceil", "round": "Round", "erf": "Erf",
    "add": "Add", "add_any": "Add", "sub": "Sub", "mul": "Mul", "div": "Div", "max": "Max", "min": "Min", "pow": "Pow",
}  # fmt: skip
"""ONNX' operator for each elementwise one of JAX."""

COMPARISONS = {
    "lt": "Less", "le": "LessOrEqual", "gt": "Greater", "ge": "GreaterOrEqual", "eq": "Equal", "and": "And", "or": "Or",
    "not": "Not",
}  # fmt: skip
"""ONNX' operator for each of JAX' that returns truth values."""

LOGIC = ("and", "or", "not")
"""Operators on truth values."""

REDUCTIONS = {
    "reduce_sum": "ReduceSum",
    "reduce_max": "ReduceMax",
    "reduce_min": "ReduceMin",
    "reduce_prod": "ReduceProd",
}
"""ONNX' operator for each of JAX' that reduces axes."""

TO_NEAREST_EVEN = 1
"""JAX' number of ONNX' rounding mode: halves to even."""

FLOAT = 1
"""ONNX' number of the type float32."""

BOOL = 9
"""ONNX' number of the type bool."""

SMALLEST = float(np.finfo(np.float32).tiny)
"""Smallest divisor in an angle: that of (0, 0) is 0, without a division by zero."""

COUNT = "batch_size"
"""Name of the tensor (1,) that holds the number of examples."""


class Node(NamedTuple):
    """One operator."""

    operator: str
    inputs: tuple[str, ...]
    output: str
    attributes: tuple[tuple[str, Any], ...]


class TensorColumn(NamedTuple):
    """The column of a tensor that holds an address."""

    tensor: str
    number: int


@dataclass
class Graph:
    """Operators in order, and their constants."""

    nodes: list[Node] = field(default_factory=list)
    constants: Tensors = field(default_factory=dict)


def onnx_graph(definition: ProgramDefinition) -> Graph:
    """Return the graph of `definition`: from the named tensors (batch, N) of its inputs to those of its outputs.

    Raises UnsupportedError for operations without an operator.
    """
    function = without_decompositions(definition.function)
    inputs = [Input((port.layout.size,)) for port in definition.inputs]
    program = trace(lambda _, *arrays: function(*arrays), None, *inputs)
    outputs = definition.output_names
    writer = _Writer(program)
    for port, addresses in zip(definition.inputs, program.inputs, strict=True):
        writer.place(addresses, port.name)
    writer.size_of_batch(definition.inputs[0].name)
    for operation in program.operations:
        writer.write(operation)
    for name, addresses in zip(outputs, program.outputs, strict=True):
        last = writer.tensor(addresses.ravel())
        writer.graph.nodes.append(Node("Identity", (last,), name, ()))
    return _needed(writer.graph, outputs)


class _Writer:
    """Writes the operations of one program; equal operators on equal inputs are written once."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.graph = Graph()
        self._columns: dict[int, TensorColumn] = {}
        self._widths: dict[str, int] = {}
        self._outputs: dict[Node, str] = {}
        self._constants: dict[tuple, str] = {}
        self._truths: dict[str, str] = {}
        """Truth values from which a tensor of zeros and ones was made."""

    def size_of_batch(self, name: str) -> None:
        """Set `COUNT` to the number of rows of the tensor `name`."""
        shape = self.node("Shape", name)
        first = self.constant(np.array([0]))
        self.graph.nodes.append(Node("Gather", (shape, first), COUNT, (("axis", 0),)))

    def place(self, addresses: Addresses, tensor: str, columns: Addresses | None = None) -> None:
        """Record that `addresses` are the columns of `tensor`, in order or numbered by `columns` (of the same shape)."""
        if columns is None:
            columns = np.arange(addresses.size)
        for address, number in zip(addresses.ravel(), columns.ravel(), strict=True):
            self._columns[int(address)] = TensorColumn(tensor, int(number))
        self._widths[tensor] = int(columns.max(initial=-1)) + 1

    def node(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Return the output of an operator, written unless it already exists."""
        node = Node(operator, inputs, "", tuple(sorted(attributes.items())))
        if node not in self._outputs:
            name = f"t{len(self._outputs)}"
            self._outputs[node] = name
            self.graph.nodes.append(node._replace(output=name))
        return self._outputs[node]

    def constant(self, numbers: np.ndarray) -> str:
        """Return the name of a constant: floats as float32, integers as int64."""
        kind = np.int64 if numbers.dtype.kind == "i" else np.float32
        array = np.ascontiguousarray(numbers, kind)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            name = f"c{len(self._constants)}"
            self._constants[key] = name
            self.graph.constants[name] = array
        return self._constants[key]

    def write(self, operation: Operation) -> None:
        """Write the operators that do `operation`; UnsupportedError if there are none."""
        name = operation.name
        if name == "round" and int(operation.params["rounding_method"]) != TO_NEAREST_EVEN:
            raise UnsupportedError("round of halves away from zero")
        if name in OPERATORS:
            self._each(operation, lambda *inputs: self.node(OPERATORS[name], *inputs))
        elif name in COMPARISONS:
            self._each(operation, lambda *inputs: self._comparison(name, *inputs))
        elif name in REDUCTIONS:
            self._reduced(operation)
        elif name == "dot_general":
            self._products(operation)
        elif name in COMPOSED:
            self._each(operation, lambda *inputs: COMPOSED[name](self, operation, *inputs))
        else:
            raise UnsupportedError(name)

    def tensor(self, addresses: Addresses) -> str:
        """Return the name of the tensor (batch, N) whose columns are `addresses` (N,)."""
        is_constant = addresses < 0
        if is_constant.all():
            return self._repeated(addresses)
        if is_constant.any():
            constants = addresses[is_constant]
            self.place(constants, self._repeated(constants))
        runs: list[tuple[str, list[int]]] = []
        for address in addresses:
            tensor, number = self._columns[int(address)]
            if not runs or runs[-1][0] != tensor:
                runs.append((tensor, []))
            runs[-1][1].append(number)
        tensors = list(dict.fromkeys(tensor for tensor, _ in runs))
        if len(runs) == len(tensors):
            return self._joined([self._chosen(tensor, numbers) for tensor, numbers in runs])
        starts = {}
        width = 0
        for tensor in tensors:
            starts[tensor] = width
            width += self._widths[tensor]
        whole = self._joined(tensors)
        self._widths[whole] = width
        numbers = [starts[tensor] + number for tensor, run in runs for number in run]
        return self._chosen(whole, numbers)

    def _joined(self, tensors: list[str]) -> str:
        if len(tensors) == 1:
            return tensors[0]
        return self.node("Concat", *tensors, axis=1)

    def _chosen(self, tensor: str, numbers: list[int]) -> str:
        """Return the tensor of these columns of `tensor`."""
        if numbers == list(range(self._widths[tensor])):
            return tensor
        return self.node("Gather", tensor, self.constant(np.array(numbers)), axis=1)

    def _repeated(self, addresses: Addresses) -> str:
        """Return constants as a tensor (batch, N)."""
        row = self.constant(self.program.constants.values(addresses)[None])
        one = self.constant(np.array([1]))
        return self.node("Expand", row, self.node("Concat", COUNT, one, axis=0))

    def _operand(self, addresses: Addresses) -> str:
        """Return a tensor that broadcasts to (batch, N): it may have one row, or one column."""
        if (addresses == addresses[0]).all():
            addresses = addresses[:1]
        if (addresses < 0).all():
            return self.constant(self.program.constants.values(addresses)[None])
        return self.tensor(addresses)

    def _each(self, operation: Operation, written: Callable[..., str]) -> None:
        """Write an elementwise operation."""
        columns = operation.entries()
        operands = [self._operand(addresses) for addresses in columns]
        output = operation.output.ravel()
        is_same_everywhere = all((addresses == addresses[0]).all() for addresses in columns)
        numbers = np.zeros(len(output), int) if is_same_everywhere else np.arange(len(output))
        self.place(output, written(*operands), numbers)

    def _comparison(self, name: str, *operands: str) -> str:
        if name in LOGIC:
            operands = tuple(self.truth(operand) for operand in operands)
        truth = self.node(COMPARISONS[name], *operands)
        number = self.node("Cast", truth, to=FLOAT)
        self._truths[number] = truth
        return number

    def truth(self, tensor: str) -> str:
        """Return the truth values of the zeros and ones in `tensor`."""
        if tensor in self._truths:
            return self._truths[tensor]
        return self.node("Cast", tensor, to=BOOL)

    def _reduced(self, operation: Operation) -> None:
        rows = operation.reduced_rows()
        table = self._shaped(self.tensor(rows.ravel()), rows.shape)
        operator = REDUCTIONS[operation.name]
        if operator == "ReduceSum":  # only it takes its axes as an input
            reduced = self.node(operator, table, self.constant(np.array([2])), keepdims=0)
        else:
            reduced = self.node(operator, table, axes=(2,), keepdims=0)
        self.place(operation.output, reduced)

    def _products(self, operation: Operation) -> None:
        """Write products of (M, K) and (K, N), one for each entry of a batch of JAX' own."""
        left, right, output = operation.matrices()
        if (left < 0).all():
            left, right = right.swapaxes(1, 2), left.swapaxes(1, 2)
            output = output.swapaxes(1, 2)
        if len(left) == 1 and left.shape[1] == 1 and (right < 0).all():
            weights = self.constant(self.program.constants.values(right[0]))
            product = self.node("MatMul", self.tensor(left.ravel()), weights)
        else:
            matrices = [
                self._shaped(self.tensor(side.ravel()), side.shape) for side in (left, right)
            ]
            product = self._shaped(self.node("MatMul", *matrices), (output.size,))
        self.place(output, product)

    def _shaped(self, tensor: str, shape: tuple[int, ...]) -> str:
        """Return a tensor (batch, N) as (batch, *shape), or back; 0 keeps a size."""
        return self.node("Reshape", tensor, self.constant(np.array([0, *shape])))


def _angle(writer: _Writer, operation: Operation, y: str, x: str) -> str:
    """Write the angle of (x, y), which ONNX lacks: twice that of (|x| + length, y), mirrored if x < 0."""
    zero = writer.constant(np.zeros(1))
    squares = writer.node("Add", writer.node("Mul", x, x), writer.node("Mul", y, y))
    far = writer.node("Add", writer.node("Sqrt", squares), writer.node("Abs", x))
    ratio = writer.node("Div", y, writer.node("Max", far, writer.constant(np.full(1, SMALLEST))))
    half = writer.node("Atan", ratio)
    angle = writer.node("Add", half, half)
    is_below = writer.node("Less", y, zero)
    straight_back = writer.node(
        "Where", is_below, writer.constant(np.full(1, -np.pi)), writer.constant(np.full(1, np.pi))
    )
    is_behind = writer.node("Less", x, zero)
    return writer.node("Where", is_behind, writer.node("Sub", straight_back, angle), angle)


def _power(writer: _Writer, operation: Operation, x: str) -> str:
    exponent = operation.params["y"]
    product = x
    for _ in range(abs(exponent) - 1):
        product = writer.node("Mul", product, x)
    if exponent < 0:
        return writer.node("Reciprocal", product)
    return product


COMPOSED: dict[str, Callable[..., str]] = {
    "atan2": _angle,
    "clamp": lambda writer, _, low, x, high: writer.node("Min", writer.node("Max", x, low), high),
    "integer_pow": _power,
    "ne": lambda writer, _, left, right: writer.node(
        "Cast", writer.node("Not", writer.node("Equal", left, right)), to=FLOAT
    ),
    "rsqrt": lambda writer, _, x: writer.node("Reciprocal", writer.node("Sqrt", x)),
    "select_n": lambda writer, _, which, if_false, if_true: writer.node(
        "Where", writer.truth(which), if_true, if_false
    ),
    "square": lambda writer, _, x: writer.node("Mul", x, x),
}
"""Functions that write operations which need several operators, or other inputs."""


def _needed(graph: Graph, outputs: list[str]) -> Graph:
    """Return the graph without what `outputs` do not depend on."""
    needed = set(outputs)
    nodes = []
    for node in reversed(graph.nodes):
        if node.output in needed:
            needed.update(node.inputs)
            nodes.append(node)
    constants = {name: array for name, array in graph.constants.items() if name in needed}
    return Graph(nodes[::-1], constants)
