"""C text for the operations of a program: loops over runs of neighbouring addresses, which compilers vectorise."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from neuroanimator.codegen.program import (
    ALIGNMENT,
    FEW,
    WIDTH,
    Addresses,
    Operation,
    Program,
    UnsupportedError,
)

ELEMENTWISE = {
    "neg": "-{0}", "sqrt": "sqrtf({0})", "rsqrt": "1.0f / sqrtf({0})", "exp": "expf({0})", "log": "logf({0})",
    "tanh": "tanhf({0})", "logistic": "1.0f / (1.0f + expf(-{0}))", "sin": "sinf({0})", "cos": "cosf({0})",
    "abs": "fabsf({0})", "square": "{0} * {0}", "not": "{0} == 0.0f", "sign": "({0} > 0.0f) - ({0} < 0.0f)",
    "floor": "floorf({0})", "round": "rintf({0})",
    "add": "{0} + {1}", "add_any": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "div": "{0} / {1}",
    "max": "{0} > {1} ? {0} : {1}", "min": "{0} < {1} ? {0} : {1}", "pow": "powf({0}, {1})",
    "atan2": "atan2f({0}, {1})", "lt": "{0} < {1}", "le": "{0} <= {1}", "gt": "{0} > {1}", "ge": "{0} >= {1}",
    "eq": "{0} == {1}", "ne": "{0} != {1}", "and": "{0} != 0.0f && {1} != 0.0f", "or": "{0} != 0.0f || {1} != 0.0f",
    "select_n": "{0} != 0.0f ? {2} : {1}",
    "clamp": "{1} < {0} ? {0} : {1} > {2} ? {2} : {1}",
}  # fmt: skip
"""C for the operations that compute entry by entry, of their inputs {0}, {1} and {2}."""

REDUCTIONS = {
    "reduce_sum": ("0.0f", "{0} + {1}"),
    "reduce_max": ("-INFINITY", "{0} > {1} ? {0} : {1}"),
    "reduce_min": ("INFINITY", "{0} < {1} ? {0} : {1}"),
    "reduce_and": ("1.0f", "{0} != 0.0f && {1} != 0.0f"),
    "reduce_or": ("0.0f", "{0} != 0.0f || {1} != 0.0f"),
}
"""For each operation that reduces axes, where it begins, and C for what is so far, {0}, and the next entry, {1}."""

ACCUMULATORS = 8
"""Registers a product of vector and matrix sums in at a time: enough to hide the latency of a fused multiply-add."""

MIN_ROWS_PER_PART = 4
"""Rows of a matrix below which a product is not divided into parts that are summed side by side."""

APART = 9
"""Any step that is no step to a neighbour."""


@dataclass
class Writer:
    """Writes the operations of one program; remembers which constants they read."""

    program: Program
    prefix: str
    """Of the constants' names."""
    used: set[int] = field(default_factory=set)
    """Blocks of constants."""
    _gathered: dict[bytes, Addresses] = field(default_factory=dict)
    """Where entries from all over have been put side by side; every address is written once, so they stay true."""

    def write(self, operation: Operation) -> Iterator[str]:
        """Yield the lines of C that do `operation`; UnsupportedError if there is no C for it."""
        if operation.name == "div" and (operation.inputs[1] < 0).all():
            numerator, divisor = operation.inputs
            inverse = self.program.constant(1 / self.program.value_of(divisor))
            yield from self._each("{0} * {1}", replace(operation, inputs=(numerator, inverse)))
        elif operation.name in ELEMENTWISE:
            yield from self._each(ELEMENTWISE[operation.name], operation)
        elif operation.name == "integer_pow":
            yield from self._each(_power(operation.params["y"]), operation)
        elif operation.name in REDUCTIONS:
            yield from self._reduced(operation)
        elif operation.name == "dot_general":
            yield from self._products(operation)
        else:
            raise UnsupportedError(operation.name)

    def copied(self, source: Addresses, target: Addresses) -> Iterator[str]:
        """Yield what copies `source` (N,) to `target` (N,)."""
        return self._elementwise("{0}", [source], target)

    def declared(self) -> Iterator[str]:
        """Yield the constants that are used, as C reads them to the last bit."""
        for block in sorted(self.used):
            numbers = self.program.constants[block]
            yield f"static const float {self.prefix}{block}[{len(numbers)}] __attribute__((aligned({ALIGNMENT}))) = {{"
            for first in range(0, len(numbers), WIDTH):
                line = numbers[first : first + WIDTH]
                yield "".join(f"{float(number).hex()}f," for number in line)
            yield "};"

    def _each(self, formula: str, operation: Operation) -> Iterator[str]:
        shape = operation.output.shape
        inputs = [np.broadcast_to(addresses, shape).ravel() for addresses in operation.inputs]
        return self._elementwise(formula, inputs, operation.output.ravel())

    def _elementwise(
        self, formula: str, inputs: list[Addresses], output: Addresses
    ) -> Iterator[str]:
        """Yield a loop for every run in which all inputs (N,) are neighbours, or one and the same."""
        for first, last in self._runs([*inputs, output]):
            if last - first <= FEW:
                for i in range(first, last):
                    terms = [self._at(column[i]) for column in inputs]
                    yield f"{self._at(output[i])} = {formula.format(*terms)};"
            else:
                target = self._in_loop(output[first:last])
                terms = [self._in_loop(column[first:last]) for column in inputs]
                yield f"for (int i = 0; i < {last - first}; i++) {target} = {formula.format(*terms)};"

    def _runs(self, columns: list[Addresses]) -> Iterator[tuple[int, int]]:
        """Yield (first, last) of the longest stretches in which every column goes on in one way."""
        steps = np.array([self._steps(column) for column in columns]).reshape(len(columns), -1)
        first = 0
        count = len(columns[0])
        while first < count:
            last = first + 1
            if last < count and (steps[:, first] != APART).all():
                changes = (steps[:, first:] != steps[:, first : first + 1]).any(axis=0)
                last += int(changes.argmax()) if changes.any() else len(changes)
            yield first, last
            first = last

    def _steps(self, column: Addresses) -> np.ndarray:
        """Return whether each address but the first is its neighbour's (1), the same (0), or `APART`."""
        ahead = np.where(column < 0, -column, column)  # constants count downwards
        step = np.diff(ahead)
        is_same_kind = (column[1:] < 0) == (column[:-1] < 0)
        blocks = np.searchsorted(self.program.starts, -column - 1, side="right")
        is_same_block = (blocks[1:] == blocks[:-1]) | (column[1:] >= 0)
        is_near = (step == 0) | (step == 1)
        return np.where(is_same_kind & is_same_block & is_near, step, APART)

    def _at(self, address: int | np.integer, index: str = "") -> str:
        """Return how C names one entry, or the entries from it on."""
        if address >= 0:
            return f"w[{address}{index}]"
        block = bisect_right(self.program.starts, -address - 1) - 1
        self.used.add(block)
        offset = -address - 1 - self.program.starts[block]
        return f"{self.prefix}{block}[{offset}{index}]"

    def _in_loop(self, run: Addresses) -> str:
        return self._at(int(run[0]), "" if run[0] == run[1] else " + i")

    def _reduced(self, operation: Operation) -> Iterator[str]:
        neutral, formula = REDUCTIONS[operation.name]
        axes = tuple(operation.params["axes"])
        rest = [axis for axis in range(operation.inputs[0].ndim) if axis not in axes]
        rows = operation.inputs[0].transpose(*rest, *axes).reshape(operation.output.size, -1)
        for address, row in zip(operation.output.ravel(), rows, strict=True):
            yield f"{{ float s = {neutral};"
            for first, last in self._runs([row]):
                if last - first <= FEW:
                    for entry in row[first:last]:
                        yield f"s = {formula.format('s', self._at(entry))};"
                else:
                    name = self._in_loop(row[first:last])
                    yield f"for (int i = 0; i < {last - first}; i++) s = {formula.format('s', name)};"
            yield f"{self._at(address)} = s; }}"

    def _products(self, operation: Operation) -> Iterator[str]:
        """Yield products of (M, K) and (K, N), one for each entry of a batch."""
        (left_sum, right_sum), (left_batch, right_batch) = operation.params["dimension_numbers"]
        left = _ordered(operation.inputs[0], left_batch, left_sum, ends_with_sum=True)
        right = _ordered(operation.inputs[1], right_batch, right_sum, ends_with_sum=False)
        outputs = operation.output.reshape(len(left), left.shape[1], right.shape[2])
        for left_matrix, right_matrix, output in zip(left, right, outputs, strict=True):
            yield from self._product(left_matrix, right_matrix, output)

    def _product(self, left: Addresses, right: Addresses, output: Addresses) -> Iterator[str]:
        if (left < 0).all() and not (right < 0).all():
            left, right, output = right.T, left.T, output.T
        if (right < 0).all() and right.shape[1] > FEW:
            weights = self.program.value_of(right)
            for row, sums in zip(left, output, strict=True):
                yield from self._weighted(row, weights, sums)
            return
        for row, sums in zip(left, output, strict=True):
            for column, address in zip(right.T, sums, strict=True):
                terms = [f"{self._at(a)} * {self._at(b)}" for a, b in zip(row, column, strict=True)]
                yield f"{self._at(address)} = {' + '.join(terms)};"

    def _weighted(self, row: Addresses, weights: np.ndarray, sums: Addresses) -> Iterator[str]:
        """Yield a vector times constant weights (K, N): sums stay in registers, weights are read in their order.

        The last few columns are summed one by one: most of a register would be empty.
        """
        vector = row
        if not self._is_a_run(row):
            key = row.tobytes()
            if key not in self._gathered:
                self._gathered[key] = self.program.room(row.shape)
                yield from self.copied(row, self._gathered[key])
            vector = self._gathered[key]
        total = sums
        if not self._is_a_run(sums) or sums[0] % WIDTH:
            total = self.program.room(sums.shape)
        tail = weights.shape[1] % WIDTH
        whole = weights.shape[1] - (tail if tail <= FEW else 0)
        for first in range(0, whole, ACCUMULATORS * WIDTH):
            columns = weights[:, first : min(whole, first + ACCUMULATORS * WIDTH)]
            yield from self._summed(int(vector[0]), columns, int(total[0]) + first)
        for last in range(whole, weights.shape[1]):
            column = self._at(int(self.program.constant(weights[:, last])[0]), " + k")
            product = f"s += w[{vector[0]} + k] * {column};"
            yield f"{{ float s = 0.0f; for (int k = 0; k < {len(weights)}; k++) {product} w[{total[last]}] = s; }}"
        if total is not sums:
            yield from self.copied(total, sums)

    def _summed(self, vector: int, weights: np.ndarray, total: int) -> Iterator[str]:
        """Yield a pass over weights (K, N) for sums that fit in registers; in parts side by side if there is room."""
        count = len(weights)
        wide = -(-weights.shape[1] // WIDTH)  # registers a row fills
        parts = max(1, min(ACCUMULATORS // wide, count // MIN_ROWS_PER_PART))
        long = -(-count // parts)  # rows of a part; the last one may have fewer
        parts = -(-count // long)
        stride = wide * WIDTH
        block = np.zeros((count, stride), np.float32)
        block[:, : weights.shape[1]] = weights
        base = self.program.constant(block)[:, 0]
        cells = [(part, j) for part in range(parts) for j in range(wide)]
        yield "{ " + " ".join(f"wide s{p}_{j} = {{0}};" for p, j in cells)
        whole = count - (parts - 1) * long
        for first, last, present in ((0, whole, parts), (whole, long, parts - 1)):
            if first < last and present:
                yield f"for (int k = {first}; k < {last}; k++) {{"
                for part in range(present):
                    rows = self._at(int(base[part * long]), f" + k * {stride}")
                    yield f"const float x{part} = w[{vector + part * long} + k];"
                    yield f"const wide *r{part} = (const wide *)&{rows};"
                    yield " ".join(f"s{part}_{j} += x{part} * r{part}[{j}];" for j in range(wide))
                yield "}"
        for j in range(wide):
            sums = " + ".join(f"s{part}_{j}" for part in range(parts))
            yield f"*(wide *)&w[{total + j * WIDTH}] = {sums};"
        yield "}"

    def _is_a_run(self, addresses: Addresses) -> bool:
        """Return whether `addresses` (N,) are neighbours in the workspace."""
        return bool(addresses[0] >= 0 and (np.diff(addresses) == 1).all())


def _power(exponent: int) -> str:
    product = " * ".join(["{0}"] * abs(exponent)) or "1.0f"
    if exponent < 0:
        return f"1.0f / ({product})"
    return product


def _ordered(value: Addresses, batch: tuple, summed: tuple, *, ends_with_sum: bool) -> Addresses:
    """Return (B, M, K), or (B, K, N)."""
    free = [axis for axis in range(value.ndim) if axis not in (*batch, *summed)]
    groups = (batch, free, summed) if ends_with_sum else (batch, summed, free)
    shape = [math.prod(value.shape[axis] for axis in axes) for axes in groups]
    order = [*groups[0], *groups[1], *groups[2]]
    return value.transpose(order).reshape(shape)
