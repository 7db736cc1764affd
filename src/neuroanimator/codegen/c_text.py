"""C text for the operations of a program: loops over runs of consecutive addresses, which compilers vectorise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, islice
from typing import NamedTuple

import numpy as np

from neuroanimator.codegen.program import (
    FEW,
    SPACE,
    SPACES,
    WIDE,
    WIDTH,
    Addresses,
    Operation,
    Program,
    free_axes,
)
from neuroanimator.codegen.trace import UnsupportedError

ELEMENTWISE = {
    "copy": "{0}", "neg": "-{0}", "sqrt": "sqrtf({0})", "rsqrt": "1.0f / sqrtf({0})", "exp": "na_exp({0})", "log": "na_log({0})",
    "tanh": "na_tanh({0})", "logistic": "na_logistic({0})", "sin": "na_sin({0})", "cos": "na_cos({0})",
    "abs": "fabsf({0})", "square": "{0} * {0}", "one_minus_square": "1.0f - {0} * {0}",
    "not": "(float)({0} == 0.0f)",
    "sign": "(float)({0} > 0.0f) - (float)({0} < 0.0f)", "floor": "floorf({0})", "ceil": "ceilf({0})",
    "exp2": "exp2f({0})", "log2": "log2f({0})", "expm1": "expm1f({0})", "log1p": "log1pf({0})",
    "asin": "asinf({0})", "acos": "acosf({0})", "atan": "na_atan2({0}, 1.0f)", "tan": "na_sin({0}) / na_cos({0})",
    "sinh": "sinhf({0})", "cosh": "coshf({0})", "cbrt": "cbrtf({0})",
    "is_finite": "(float)({0} - {0} == 0.0f)",
    "add": "{0} + {1}", "add_any": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "div": "{0} / {1}",
    "max": "{0} > {1} ? {0} : {1}", "min": "{0} < {1} ? {0} : {1}", "pow": "powf({0}, {1})",
    "rem": "fmodf({0}, {1})", "atan2": "na_atan2({0}, {1})",
    "lt": "(float)({0} < {1})", "le": "(float)({0} <= {1})", "gt": "(float)({0} > {1})", "ge": "(float)({0} >= {1})",
    "eq": "(float)({0} == {1})", "ne": "(float)({0} != {1})",
    "and": "(float)({0} != 0.0f && {1} != 0.0f)", "or": "(float)({0} != 0.0f || {1} != 0.0f)",
    "select_n": "{0} != 0.0f ? {2} : {1}",
    "clamp": "{1} < {0} ? {0} > {2} ? {2} : {0} : {1} > {2} ? {2} : {1}",
}  # fmt: skip
"""C for elementwise operations, in terms of their inputs {0}, {1} and {2}."""

ROUNDED = {"AWAY_FROM_ZERO": "roundf({0})", "TO_NEAREST_EVEN": "rintf({0})"}
"""C for the operation `round`, by its rule for halves."""

MOST_SELECTED = 3
"""Maximum number of inputs of `select_n` with C: a truth value and two cases."""

REDUCTIONS = {
    "reduce_sum": ("0.0f", "{s} + {0}"),
    "reduce_max": ("-INFINITY", "{s} > {0} ? {s} : {0}"),
    "reduce_min": ("INFINITY", "{s} < {0} ? {s} : {0}"),
    "reduce_and": ("1.0f", "(float)({s} != 0.0f && {0} != 0.0f)"),
    "reduce_or": ("0.0f", "(float)({s} != 0.0f || {0} != 0.0f)"),
}
"""For each operation that reduces axes, its initial value, and C to combine the result so far, {s}, and an entry, {0}."""

DOT = ("0.0f", "{s} + {0} * {1}")
"""The same for the dot product of two vectors."""

ACCUMULATORS = 6
"""Number of sixteen-wide sums in a vector-matrix product: with AVX2 they take twelve of sixteen registers."""

MAX_PANEL = ACCUMULATORS * WIDTH
"""Maximum number of columns of a panel."""

MIN_ROWS_PER_PART = 4
"""Minimum number of matrix rows in each of the parts of a product that are summed in parallel."""

WORTH_A_LOOP = 3
"""Minimum number of consecutive equal runs that are written as a loop."""

MANY_LOOPS = 16
"""Minimum number of loops in an operation for a search for repeating sequences."""

MAX_GROUP = 16
"""Maximum number of loops in such a sequence."""

DIGITS = 9
"""Number of decimal digits that distinguish all float32; C++ before 2017 reads no hexadecimal ones."""

APART = 9
"""Stands for any step other than 0 or 1."""


class Loop(NamedTuple):
    """A run of `length` equal statements."""

    first: tuple[int, ...]
    """Address of each column at the first statement."""
    steps: tuple[int, ...]
    """Step of each column within the run: 0 or 1."""
    length: int
    outer: tuple[int, ...] = ()
    """Step of each column at every repetition of the loop's group; empty for a loop outside of groups."""

    def unrolled(self) -> list[Loop]:
        """Return loops of one statement each."""
        loops = []
        for number in range(self.length):
            steps = [
                _upwards(first) * step for first, step in zip(self.first, self.steps, strict=True)
            ]
            first = tuple(np.add(self.first, np.multiply(number, steps)).tolist())
            loops.append(Loop(first, (0,) * len(first), 1))
        return loops


class Group(NamedTuple):
    """A sequence of loops, repeated `repeats` times."""

    loops: list[Loop]
    repeats: int


class Panel(NamedTuple):
    """Some columns of a weight matrix, contiguous in memory, in row order; rows are padded to whole registers."""

    base: int
    """Offset among the constants."""
    rows: int
    first: int
    """Number of its first column in the matrix."""
    columns: int
    stride: int
    """Number of floats from one row to the next."""


@dataclass
class Writer:
    """Writes the operations of one program."""

    program: Program

    def write(self, operation: Operation) -> Iterator[str]:
        """Yield the lines of C for `operation`; UnsupportedError if there is none."""
        if operation.name == "div" and are_weights(self.program, operation.inputs[1]):
            numerator, divisor = operation.inputs
            constants = self.program.constants
            inverse = constants.add(1 / constants.values(divisor))
            yield from self._each("{0} * {1}", replace(operation, inputs=(numerator, inverse)))
        elif operation.name in ("max", "min"):
            # The computed operand comes last, so that NaN stays NaN.
            ordered = sorted(operation.inputs, key=lambda addresses: bool((addresses >= 0).any()))
            yield from self._each(
                ELEMENTWISE[operation.name], replace(operation, inputs=tuple(ordered))
            )
        elif operation.name == "select_n" and len(operation.inputs) > MOST_SELECTED:
            raise UnsupportedError("select_n of more than two")
        elif operation.name == "round":
            yield from self._each(ROUNDED[operation.params["rounding_method"].name], operation)
        elif operation.name in ELEMENTWISE:
            yield from self._each(ELEMENTWISE[operation.name], operation)
        elif operation.name == "integer_pow":
            yield from self._each(power(operation.params["y"]), operation)
        elif operation.name in REDUCTIONS:
            yield from self._reduced(operation)
        elif operation.name == "dot_general":
            yield from self._products(operation)
        elif operation.name == "eigh":
            yield from self._eigen(operation)
        else:
            raise UnsupportedError(operation.name)

    def copied(self, source: Addresses, target: Addresses) -> Iterator[str]:
        """Yield statements that copy `source` (N,) to `target` (N,)."""
        return self._elementwise("{0}", [source], target)

    def stored(self, source: Addresses, name: str, *, is_wide: bool) -> Iterator[str]:
        """Yield statements that copy `source` (N,) to the array `name`, which has lanes if it `is_wide`."""
        target = np.arange(len(source)) + OUTSIDE * SPACE

        def store(loop: Loop) -> str:
            index = _index(loop, 1)
            entry = f"LANES * ({index}) + l" if is_wide else index
            return f"{name}[{entry}] = {self._term(loop, 0)};"

        return self._statements([source, target], store, is_wide=is_wide)

    def loaded(self, name: str, target: Addresses) -> Iterator[str]:
        """Yield statements that copy the array `name`, which has lanes if `target` has, to `target` (N,)."""
        if not len(target):
            return
        space = int(target[0]) // SPACE
        offset = int(target[0]) % SPACE
        lanes = "LANES * " if space & WIDE else ""
        yield f"memcpy({SPACES[space]} + {lanes}{offset}, {name}, {lanes}{len(target)} * sizeof(float));"

    def _each(self, formula: str, operation: Operation) -> Iterator[str]:
        return self._elementwise(formula, operation.entries(), operation.output.ravel())

    def _elementwise(
        self, formula: str, inputs: Sequence[Addresses], output: Addresses
    ) -> Iterator[str]:
        """Yield statements that compute each entry of `output` (N,) from those of each input (N,)."""

        def compute(loop: Loop) -> str:
            terms = [self._term(loop, column) for column in range(len(inputs))]
            return f"{self._term(loop, len(inputs))} = {formula.format(*terms)};"

        return self._statements([*inputs, output], compute, is_wide=is_any_wide(output))

    def _statements(
        self, columns: Sequence[Addresses], write: Callable[[Loop], str], *, is_wide: bool
    ) -> Iterator[str]:
        """Yield the statements that `write` writes, in loops over runs in which the addresses of each column are consecutive,
        or the same."""
        for group in self._groups(list(self._loops(columns))):
            statements = [_looped(loop, write(loop), is_wide=is_wide) for loop in group.loops]
            if group.repeats == 1:
                yield from statements
            else:
                yield f"for (int g = 0; g < {group.repeats}; g++) {{ {' '.join(statements)} }}"

    def _groups(self, loops: list[Loop]) -> Iterator[Group]:
        """Yield `loops` in order, repeating sequences as one group."""
        number = 0
        while number < len(loops):
            sizes = range(1, MAX_GROUP + 1 if len(loops) >= MANY_LOOPS else 2)
            left = len(loops) - number
            counts: dict[int, int] = {}
            for size in sizes:
                counts[size] = self._repeats(loops, number, size)
                if size * (counts[size] + 1) > left:
                    break  # nothing is left for a longer sequence to be better
            period = max(counts, key=lambda size: size * counts[size])
            repeats = counts[period]
            if repeats < WORTH_A_LOOP:
                loop = loops[number]
                yield Group(loop.unrolled() if loop.length <= FEW else [loop], 1)
                number += 1
                continue
            group = []
            for loop, following in zip(loops[number:], loops[number + period :], strict=False):
                if len(group) < period:
                    group.append(loop._replace(outer=self._apart(loop, following)))
            yield Group(group, repeats)
            number += period * repeats

    def _repeats(self, loops: list[Loop], first: int, period: int) -> int:
        """Return how many times the `period` loops from `first` on repeat, with equal steps."""
        steps = []
        for number in range(first, len(loops) - period):
            step = self._apart(loops[number], loops[number + period])
            is_first = number < first + period
            if step is None or not (is_first or step == steps[(number - first) % period]):
                return (number - first) // period + 1
            if is_first:
                steps.append(step)
        return (len(loops) - first) // period

    def _apart(self, loop: Loop, other: Loop) -> tuple[int, ...] | None:
        """Return the step of each column from `loop` to `other`; None unless the loops are alike."""
        if loop[1:] != other[1:]:
            return None
        literals = self.program.constants.literals
        steps = []
        for before, now in zip(loop.first, other.first, strict=True):
            step = _upwards(now) * now - _upwards(before) * before
            if before // SPACE != now // SPACE or (
                step and (before in literals or now in literals)
            ):
                return None
            steps.append(step)
        return tuple(steps)

    def _loops(self, columns: Sequence[Addresses]) -> Iterator[Loop]:
        """Yield the statements over `columns` (N,), merged into loops where they are consecutive."""
        if not len(columns[0]):
            return
        for column in columns:
            self.program.constants.mark_read(column)
        for first, last in self._runs(columns):
            starts = tuple(int(column[first]) for column in columns)
            steps = (0,) * len(columns)
            if last - first > 1:
                steps = tuple(abs(int(column[first + 1] - column[first])) for column in columns)
            yield Loop(starts, steps, last - first)

    def _runs(self, columns: Sequence[Addresses]) -> Iterator[tuple[int, int]]:
        """Yield (first, last) of the longest runs in which the step of every column is constant."""
        steps = np.array([self._steps(column) for column in columns]).reshape(len(columns), -1)
        count = len(columns[0])
        is_apart = (steps == APART).any(axis=0)
        changes = np.flatnonzero((steps[:, 1:] != steps[:, :-1]).any(axis=0))
        first = 0
        while first < count:
            last = first + 1
            if last < count and not is_apart[first]:
                change = int(np.searchsorted(changes, first))
                last = int(changes[change]) + 2 if change < len(changes) else count
            yield first, last
            first = last

    def _steps(self, column: Addresses) -> np.ndarray:
        """Return the step to each address from the one before: 1, 0, or `APART` for any other."""
        step = np.diff(np.where(column < 0, -column, column))
        is_same_space = column[1:] // SPACE == column[:-1] // SPACE
        is_near = (step == 0) | (step == 1)
        return np.where(is_same_space & is_near, step, APART)

    def _term(self, loop: Loop, column: int) -> str:
        """Return the C expression of a column's entry in the loop."""
        address = loop.first[column]
        literal = self.program.constants.literals.get(address)
        if literal is not None and not loop.steps[column]:
            return c_number(literal)
        index = _index(loop, column)
        if address < 0:
            return f"k[{index}]"
        space = address // SPACE
        if space & WIDE:
            return f"{SPACES[space]}[LANES * ({index}) + l]"
        return f"{SPACES[space]}[{index}]"

    def _reduced(self, operation: Operation) -> Iterator[str]:
        rows = operation.reduced_rows()
        yield from self._accumulated(REDUCTIONS[operation.name], [rows], operation.output.ravel())

    def _accumulated(
        self, rule: tuple[str, str], inputs: Sequence[Addresses], output: Addresses
    ) -> Iterator[str]:
        """Yield statements that reduce rows, one of each of `inputs` (N, R), to the entries of `output` (N,)."""
        count = inputs[0].shape[1]
        if count <= 2 * FEW and rule[1].startswith("{s} +"):
            product = " * ".join("{%d}" for _ in inputs)
            terms = []
            for entry in range(count):
                places = tuple(entry * len(inputs) + which for which in range(len(inputs)))
                terms.append(product % places)
            columns = [rows[:, entry] for entry in range(count) for rows in inputs]
            yield from self._elementwise(" + ".join(terms), columns, output)
        elif 0 < count <= 2 * FEW and len(inputs) == 1 and len(output) >= MANY_LOOPS:
            yield from self.copied(inputs[0][:, 0], output)
            formula = rule[1].format("{1}", s="{0}")
            for entry in range(1, count):
                yield from self._elementwise(formula, [output, inputs[0][:, entry]], output)
        else:
            for row in range(len(output)):
                vectors = [rows[row] for rows in inputs]
                yield from self._gathered_row(rule, vectors, int(output[row]))

    def _gathered_row(
        self, rule: tuple[str, str], row: Sequence[Addresses], target: int
    ) -> Iterator[str]:
        """Yield statements that reduce one row, the vectors `row` (R,), to the entry `target`."""
        neutral, formula = rule
        place = self._term(Loop((target,), (0,), 1), 0)
        is_wide = is_any_wide(np.array([target]))
        if is_wide:
            yield f"{EACH_LANE}{place} = {neutral};"
        else:
            yield f"{{ float s = {neutral};"
        so_far = place if is_wide else "s"

        def add(loop: Loop) -> str:
            terms = [self._term(loop, column) for column in range(len(row))]
            return f"{so_far} = {formula.format(*terms, s=so_far)};"

        yield from self._statements(row, add, is_wide=is_wide)
        if not is_wide:
            yield f"{place} = s; }}"

    def _eigen(self, operation: Operation) -> Iterator[str]:
        """Yield statements that compute eigenvectors and eigenvalues of a matrix, lane by lane."""
        matrix = operation.inputs[0]
        size = len(matrix)
        outputs = operation.output.ravel()
        within = np.arange(len(outputs)) + OUTSIDE * SPACE

        def load(loop: Loop) -> str:
            return f"a[{_index(loop, 1)}] = {self._term(loop, 0)};"

        def store(loop: Loop) -> str:
            return f"{self._term(loop, 0)} = q[{_index(loop, 1)}];"

        columns = [matrix.ravel(), within[: matrix.size]]
        statements = [
            f"float a[{size * size}], q[{size * (size + 1)}];",
            *self._statements(columns, load, is_wide=False),
            f"na_eigh({size}, a, q, q + {size * size});",
            *self._statements([outputs, within], store, is_wide=False),
        ]
        each_lane = EACH_LANE if is_any_wide(outputs) else ""
        yield f"{each_lane}{{ {' '.join(statements)} }}"

    def _products(self, operation: Operation) -> Iterator[str]:
        """Yield products of (M, K) and (K, N), one per entry of a batch."""
        left, right, outputs = operation.matrices()
        rest: list[tuple[Addresses, Addresses, Addresses]] = []
        for left_matrix, right_matrix, output in zip(left, right, outputs, strict=True):
            if are_weights(self.program, left_matrix) and not are_weights(
                self.program, right_matrix
            ):
                left_matrix, right_matrix, output = right_matrix.T, left_matrix.T, output.T
            if are_weights(self.program, right_matrix) and right_matrix.shape[1] > FEW:
                weights = self.program.constants.values(right_matrix)
                for row, sums in zip(left_matrix, output, strict=True):
                    yield from self._weighted(row, weights, sums)
            else:
                rest.append((left_matrix, right_matrix, output))
        if rest:
            yield from self._small_products(rest)

    def _small_products(
        self, products: list[tuple[Addresses, Addresses, Addresses]]
    ) -> Iterator[str]:
        """Yield products of (M, K) and (K, N) entry by entry, a whole batch at once."""
        rows = []
        columns = []
        targets = []
        for left, right, output in products:
            shape = (left.shape[0], right.shape[1], left.shape[1])
            rows.append(np.broadcast_to(left[:, None, :], shape).reshape(-1, shape[2]))
            columns.append(np.broadcast_to(right.T[None], shape).reshape(-1, shape[2]))
            targets.append(output.ravel())
        inputs = [np.concatenate(rows), np.concatenate(columns)]
        yield from self._accumulated(DOT, inputs, np.concatenate(targets))

    def _weighted(self, row: Addresses, weights: np.ndarray, sums: Addresses) -> Iterator[str]:
        """Yield a vector times constant weights (K, N): sums stay in registers, weights are read in order."""
        vector = row
        if not _is_a_run(row):
            vector = self.program.room_for_result(row.shape, (row, sums))
            yield from self.copied(row, vector)
        total = self._aligned(sums)
        if is_any_wide(vector):
            yield from self._weighted_lanes(vector, weights, total)
        else:
            panels, tail = self._panels(weights)
            for panel in panels:
                yield from self._summed(int(vector[0]), panel, int(total[0]) + panel.first)
            for last in tail:
                # The last few columns are summed one by one: they would leave most of a register empty.
                column = -int(self._laid_out(weights[:, last])[0]) - 1
                x = f"{_name(int(vector[0]))}]"
                yield f"{_name(int(total[last]))}] = na_dot({len(vector)}, &{x}, k + {column});"
        if total is not sums:
            yield from self.copied(total, sums)

    def _panels(self, weights: np.ndarray) -> tuple[list[Panel], range]:
        """Return the panels of weights (K, N), and the last columns left out, if too few for a register."""
        columns = weights.shape[1]
        rest = columns % WIDTH
        whole = columns - (rest if rest <= FEW else 0)
        panels = []
        for first in range(0, whole, MAX_PANEL):
            last = min(whole, first + MAX_PANEL)
            panels.append(self._panel(weights, range(first, last)))
        return panels, range(whole, columns)

    def _panel(self, weights: np.ndarray, columns: range) -> Panel:
        """Return a panel of some columns of weights (K, N)."""
        count = len(weights)
        stride = -(-len(columns) // WIDTH) * WIDTH
        block = np.zeros((count, stride), np.float32)
        block[:, : len(columns)] = weights[:, columns.start : columns.stop]
        base = -int(self._laid_out(block).flat[0]) - 1
        return Panel(base, count, columns.start, len(columns), stride)

    def _laid_out(self, weights: np.ndarray) -> Addresses:
        """Return the addresses of weights in the order in which a loop reads them."""
        addresses = self.program.constants.add(weights)
        self.program.constants.mark_read(addresses)
        return addresses

    def _summed(self, vector: int, panel: Panel, total: int) -> Iterator[str]:
        """Yield a pass over a panel, whose sums fit in registers; in parallel parts if there is room."""
        count = panel.rows
        stride = panel.stride
        wide = stride // WIDTH  # registers per row
        parts = max(1, min(ACCUMULATORS // wide, count // MIN_ROWS_PER_PART))
        long = -(-count // parts)  # rows of a part; the last one may have fewer
        parts = -(-count // long)
        cells = [(part, j) for part in range(parts) for j in range(wide)]
        names = ", ".join(f"s{part}_{j}" for part, j in cells)
        zeros = " ".join(f"NA_ZERO(s{part}_{j});" for part, j in cells)
        yield f"{{ na_wide {names}; {zeros}"
        whole = count - (parts - 1) * long
        for first, last, present in ((0, whole, parts), (whole, long, parts - 1)):
            if first < last and present:
                yield f"for (int q = {first}; q < {last}; q++) {{"
                for part in range(present):
                    yield f"const float v{part} = {_name(vector + part * long)} + q];"
                    yield f"const na_wide *r{part} = (const na_wide *)(k + {panel.base + part * long * stride} + q * {stride});"
                    yield " ".join(
                        f"NA_MULTIPLY_ADD(s{part}_{j}, r{part}[{j}], v{part});" for j in range(wide)
                    )
                yield "}"
        for j in range(wide):
            for part in range(1, parts):
                yield f"NA_ADD(s0_{j}, s{part}_{j});"
            yield f"*(na_wide *)&{_name(total + j * WIDTH)}] = s0_{j};"
        yield "}"

    def _aligned(self, sums: Addresses) -> Addresses:
        """Return `sums`, or other room for them: passes write whole registers, which need aligned room."""
        if _is_a_run(sums) and sums[0] % WIDTH == 0:
            return sums
        return self.program.room_for_result(sums.shape, (sums,))

    def _weighted_lanes(
        self, vector: Addresses, weights: np.ndarray, total: Addresses
    ) -> Iterator[str]:
        """Yield the product for all lanes: each weight is read once for all sixteen, as often as for one motion."""
        panels, tail = self._panels(weights)
        if tail:
            panels.append(self._panel(weights, tail))
        x = _register(int(vector[0]))
        for panel in panels:
            y = _register(int(total[0]) + panel.first)
            sizes = f"{panel.columns}, {panel.rows}, {panel.stride}"
            yield f"na_lane_products({sizes}, k + {panel.base}, {x}, {y});"


def are_weights(program: Program, addresses: Addresses) -> bool:
    """Return whether all of `addresses` are constants, and none of them is a literal in the text."""
    literals = program.constants.literals
    if not (addresses < 0).all():
        return False
    return not any(int(address) in literals for address in np.unique(addresses))


def with_gathered_rows(program: Program, operations: Iterable[Operation]) -> Iterator[Operation]:
    """Yield `operations`, with copies before products with weights that make scattered rows contiguous.

    Rows that several products read are copied once.
    """
    gathered: dict[bytes, Addresses] = {}
    for operation in operations:
        inputs = operation.inputs
        if operation.name != "dot_general" or not any(are_weights(program, one) for one in inputs):
            yield operation
            continue
        axes = operation.params["dimension_numbers"]
        changed = list(inputs)
        for side, value in enumerate(inputs):
            summed, batch = axes[0][side], axes[1][side]
            order = [*batch, *free_axes(value, batch, summed), *summed]
            rows = value.transpose(order).reshape(-1, math.prod(value.shape[n] for n in summed))
            if are_weights(program, value) or all(_is_a_run(row) for row in rows):
                continue
            key = rows.tobytes()
            if key not in gathered:
                gathered[key] = program.room_for_result(rows.shape, (rows, operation.output))
                yield Operation("copy", (rows,), gathered[key], {})
            shape = [value.shape[axis] for axis in order]
            changed[side] = gathered[key].reshape(shape).transpose(np.argsort(order))
        yield replace(operation, inputs=tuple(changed))


EACH_LANE = "NA_EACH_LANE "
"""Prefix of a statement that is executed for every lane."""

STATEMENTS_PER_LOOP = 24
"""Maximum number of statements in a loop over lanes: numbers stay in registers between them, and there are fewer loops."""

OUTSIDE = len(SPACES)
"""Number for an argument of the function, which is in no space."""


def fused(lines: Iterable[str]) -> Iterator[str]:
    """Yield `lines`, with consecutive statements over lanes fused into one loop: lanes are independent."""
    for is_alike, group in groupby(lines, lambda line: line.startswith(EACH_LANE)):
        if not is_alike:
            yield from group
            continue
        while together := list(islice(group, STATEMENTS_PER_LOOP)):
            yield f"{EACH_LANE}{{"
            yield from (line.removeprefix(EACH_LANE) for line in together)
            yield "}"


def is_any_wide(addresses: Addresses) -> bool:
    """Return whether any of `addresses` has lanes."""
    inside = addresses[addresses >= 0]
    return bool(((inside // SPACE) & WIDE).any())


def _is_a_run(addresses: Addresses) -> bool:
    """Return whether `addresses` (N,) are consecutive in one space."""
    return bool(addresses[0] >= 0 and (np.diff(addresses) == 1).all())


def _upwards(address: int) -> int:
    """Return the sign with which an address counts upwards: addresses of constants count downwards."""
    return -1 if address < 0 else 1


def _looped(loop: Loop, statement: str, *, is_wide: bool) -> str:
    """Return `statement` within the loops it needs."""
    lanes = EACH_LANE if is_wide else ""
    if loop.length == 1:
        return lanes + statement
    return f"for (int i = 0; i < {loop.length}; i++) {lanes}{statement}"


def _name(address: int) -> str:
    """Return the C expression of an entry without lanes, up to the closing bracket."""
    return f"{SPACES[address // SPACE]}[{address % SPACE}"


def _register(address: int) -> str:
    """Return the C pointer to an entry with lanes."""
    return f"(na_wide *)({SPACES[address // SPACE]} + LANES * {address % SPACE})"


def _index(loop: Loop, column: int) -> str:
    """Return the index of a column in the loop."""
    address = loop.first[column]
    text = str(-address - 1 if address < 0 else address % SPACE)
    if loop.length > 1 and loop.steps[column]:
        text += " + i"
    if loop.outer and loop.outer[column]:
        text += f" + {loop.outer[column]} * g"
    return text


def c_number(number: float) -> str:
    """Return a number in C, exact to the last bit."""
    if math.isinf(number):
        return "INFINITY" if number > 0 else "-INFINITY"
    if math.isnan(number):
        return "NAN"
    text = f"{np.float32(number):.{DIGITS}g}"
    if text.lstrip("-").isdigit():
        text += ".0"
    return f"({text}f)" if number < 0 else f"{text}f"


def power(exponent: int) -> str:
    product = " * ".join(["{0}"] * abs(exponent)) or "1.0f"
    if exponent < 0:
        return f"1.0f / ({product})"
    return product
