"""A function as a list of operations on addresses, from which source code can be written.

Values are arrays of addresses: operations that only move data (slices, concatenations, transposes) are applied to the
addresses once and leave no code. In a program with a backward part (a vector-Jacobian product), values that depend on
the cotangents are *late*, all others *early*; early values that late operations read are kept on a *tape*. A value
is *wide* if it has sixteen lanes, one for each of sixteen motions or cotangents in parallel.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

WIDTH = 16
"""Alignment of arrays [floats], and number of lanes of wide values: an AVX-512 register, two of AVX2, four of NEON."""

FLOAT_BYTES = 4
"""Size of a float32 [bytes]."""

FEW = 4
"""Maximum length of arrays that share a line of memory: scalars, vectors and quaternions."""

SPACE = 1 << 24
"""Number of addresses in a space; an address is its space times this, plus an offset."""

EARLY = 0
LATE = 1
WIDE = 2
"""Spaces are numbered by their content: `EARLY` or `LATE`, plus `WIDE` for lanes."""

TAPE = 4
"""Space of values kept for late operations; `TAPE + WIDE` for lanes."""

SPACES = ("w", "d", "v", "e", "t", None, "tv")
"""Names of the spaces' arrays in C."""

Addresses = np.ndarray
"""Address of each entry of a value: from 0 up in the spaces, from -1 down among the constants."""


@dataclass
class Constants:
    """The float32 numbers that the programs of one library read; data, so that another emulator has the same text."""

    blocks: list[np.ndarray] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    size: int = 0
    """Number of floats in all blocks and the gaps between them."""
    literals: dict[int, float] = field(default_factory=dict)
    """Numbers of the definition itself, by address, such as zeros and ones, which are written into the text."""
    _of_literal: dict[float, int] = field(default_factory=dict)
    _read: set[int] = field(default_factory=set)
    """Numbers of the blocks that programs read: weights are read in a new layout for loops, not in the original one."""

    def add(self, numbers: ArrayLike) -> Addresses:
        """Return the addresses of `numbers`, in their shape; the first is aligned."""
        block = np.asarray(numbers, np.float32)
        first = self.size
        self.blocks.append(block.ravel())
        self.starts.append(first)
        self.size += -(-max(block.size, 1) // WIDTH) * WIDTH
        return np.asarray(-(first + np.arange(block.size).reshape(block.shape)) - 1)

    def literal(self, number: float) -> int:
        """Return the address of a number that does not depend on the weights."""
        number += 0.0  # turns -0 into 0
        if number not in self._of_literal:
            address = int(self.add([number])[0])
            self._of_literal[number] = address
            self.literals[address] = number
        return self._of_literal[number]

    def literal_array(self, numbers: np.ndarray) -> Addresses:
        """Return the addresses of numbers that do not depend on the weights; equal numbers share one."""
        distinct, which = np.unique(numbers, return_inverse=True)
        if len(distinct) > FEW:
            return self.add(numbers)
        addresses = np.array([self.literal(number) for number in distinct.tolist()], int)
        return np.asarray(addresses[which]).reshape(numbers.shape)

    def values(self, addresses: Addresses) -> np.ndarray:
        """Return the constants at `addresses`, which must all be constants."""
        return self._laid_out(range(len(self.blocks)))[-addresses - 1]

    def mark_read(self, addresses: Addresses) -> None:
        """Mark the constants among `addresses` as read by a program, so that they are kept."""
        places = -addresses[addresses < 0] - 1
        blocks = np.searchsorted(self.starts, places, side="right") - 1
        self._read.update(np.unique(blocks).tolist())

    def data(self) -> np.ndarray:
        """Return all numbers that programs read in one float32 array, aligned for the widest register; others are zero."""
        return self._laid_out(sorted(self._read))

    def _laid_out(self, blocks: Iterable[int]) -> np.ndarray:
        numbers = aligned_zeros(self.size)
        for number in blocks:
            start = self.starts[number]
            block = self.blocks[number]
            numbers[start : start + len(block)] = block
        return numbers


def aligned_zeros(count: int) -> np.ndarray:
    """Return `count` float32 zeros, aligned for the widest register."""
    raw = np.zeros(count + WIDTH, np.float32)
    first = -(raw.ctypes.data // FLOAT_BYTES) % WIDTH
    return raw[first : first + count]


@dataclass(frozen=True)
class Operation:
    """An operation that computes, by JAX's name and parameters, on addresses."""

    name: str
    inputs: tuple[Addresses, ...]
    output: Addresses
    params: dict[str, Any]

    @property
    def is_late(self) -> bool:
        """Whether it depends on a late input."""
        return bool(self.space & LATE)

    @property
    def space(self) -> int:
        """The space of its output, which is all in one."""
        return int(self.output.flat[0]) // SPACE

    def entries(self) -> list[Addresses]:
        """Return the inputs of an elementwise operation, (N,) each, one for every entry of its output."""
        shape = self.output.shape
        return [np.broadcast_to(addresses, shape).ravel() for addresses in self.inputs]

    def reduced_rows(self) -> Addresses:
        """Return the input of a reduction as rows (N, R), one for each entry of its output."""
        axes = tuple(self.params["axes"])
        (source,) = self.inputs
        rest = [axis for axis in range(source.ndim) if axis not in axes]
        return source.transpose(*rest, *axes).reshape(self.output.size, -1)

    def matrices(self) -> tuple[Addresses, Addresses, Addresses]:
        """Return the factors and the output of `dot_general`: (B, M, K), (B, K, N) and (B, M, N)."""
        (left_sum, right_sum), (left_batch, right_batch) = self.params["dimension_numbers"]
        left = ordered_axes(self.inputs[0], left_batch, left_sum, ends_with_sum=True)
        right = ordered_axes(self.inputs[1], right_batch, right_sum, ends_with_sum=False)
        return left, right, self.output.reshape(len(left), left.shape[1], right.shape[2])


def spaces_of(addresses: Addresses) -> np.ndarray:
    """Return the space of each address; negative for constants."""
    return np.asarray(addresses // SPACE)


class Numbering:
    """Consecutive numbers for the addresses of all spaces, so that one array can hold a value for each."""

    def __init__(self, sizes: dict[int, int]):
        """`sizes` are those of the spaces."""
        self.count = 0
        """Count of numbers; the last one stands for all constants."""
        # One more entry than spaces: constants have space -1, the last.
        self._begins = np.zeros(len(SPACES) + 1, int)
        for space, size in sizes.items():
            self._begins[space] = self.count
            self.count += size
        self._begins[-1] = self.count
        self.count += 1

    def of(self, addresses: Addresses) -> np.ndarray:
        """Return the number of each address."""
        offsets = np.where(addresses < 0, 0, addresses % SPACE)
        return np.asarray(self._begins[addresses // SPACE] + offsets)


def ordered_axes(
    value: Addresses, batch: tuple, summed: tuple, *, ends_with_sum: bool
) -> Addresses:
    """Return a factor of `dot_general` as matrices: (B, M, K) if it `ends_with_sum`, otherwise (B, K, N)."""
    free = free_axes(value, batch, summed)
    groups = (batch, free, summed) if ends_with_sum else (batch, summed, free)
    shape = [math.prod(value.shape[axis] for axis in axes) for axes in groups]
    order = [*groups[0], *groups[1], *groups[2]]
    return value.transpose(order).reshape(shape)


def free_axes(value: Addresses, batch: tuple, summed: tuple) -> tuple[int, ...]:
    """Return the axes of a factor of `dot_general` that its product keeps, except those of the batch."""
    return tuple(axis for axis in range(value.ndim) if axis not in (*batch, *summed))


@dataclass
class Program:
    """(inputs) → outputs by `operations`."""

    constants: Constants = field(default_factory=Constants)
    inputs: list[Addresses] = field(default_factory=list)
    outputs: list[Addresses] = field(default_factory=list)
    operations: list[Operation] = field(default_factory=list)
    sizes: dict[int, int] = field(default_factory=dict)
    """Number of floats (or registers of lanes) in each space."""
    _blocks: dict[int, list[int]] = field(default_factory=dict)
    """Per space, the beginnings of contiguous values."""
    _free: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Per space, where the next short array goes and where its line ends."""

    def room(self, shape: tuple[int, ...], space: int) -> Addresses:
        """Return fresh addresses of this shape: aligned, with room for whole registers, unless the array is short."""
        count = math.prod(shape)
        size = self.sizes.get(space, 0)
        if count > FEW:
            first = size
            self.sizes[space] = size + -(-count // WIDTH) * WIDTH
            self._blocks.setdefault(space, []).append(first)
        else:
            first, line_end = self._free.get(space, (0, 0))
            if first + count > line_end:
                first = size
                line_end = size + WIDTH
                self.sizes[space] = line_end
                self._blocks.setdefault(space, []).append(first)
            self._free[space] = (first + count, line_end)
        return np.asarray(space * SPACE + first + np.arange(count).reshape(shape))

    def room_for_result(self, shape: tuple[int, ...], inputs: tuple[Addresses, ...]) -> Addresses:
        """Return fresh addresses for a result of `inputs`: late if any of them is, wide if any of them is."""
        space = EARLY
        for addresses in inputs:
            spaces = spaces_of(addresses[addresses >= 0])
            space |= int(np.bitwise_or.reduce(spaces & (LATE | WIDE), axis=None, initial=0))
        return self.room(shape, space)

    def keep_needed(self) -> None:
        """Drop the operations that no output depends on."""
        self.operations = self.needed_by(self.outputs)

    def needed_by(self, outputs: list[Addresses]) -> list[Operation]:
        """Return the operations that `outputs` depend on."""
        numbering = Numbering(self.sizes)
        is_needed = np.zeros(numbering.count, bool)
        for output in outputs:
            is_needed[numbering.of(output)] = True
        needed = []
        for operation in reversed(self.operations):
            if is_needed[numbering.of(operation.output)].any():
                for addresses in operation.inputs:
                    is_needed[numbering.of(addresses)] = True
                needed.append(operation)
        return needed[::-1]

    def read(self) -> list[np.ndarray]:
        """Return, for each input and in its shape, which of its entries operations or outputs read."""
        read = [addresses for operation in self.operations for addresses in operation.inputs]
        addresses = np.concatenate([some.ravel() for some in [*read, *self.outputs]])
        return [np.isin(entries, addresses) for entries in self.inputs]

    def keep_tape(self) -> None:
        """Move early values that late operations or outputs read to consecutive addresses on the tape."""
        late = [operation for operation in self.operations if operation.is_late]
        read = [addresses for operation in late for addresses in operation.inputs]
        read += [output for output in self.outputs if (spaces_of(output) % 2 == LATE).any()]
        moved: dict[int, np.ndarray] = {}
        for space in (EARLY, EARLY | WIDE):
            size = self.sizes.get(space, 0)
            is_kept = np.zeros(size, bool)
            for addresses in read:
                inside = addresses[(addresses >= 0) & (spaces_of(addresses) == space)]
                is_kept[inside - space * SPACE] = True
            # Whole blocks, so that they stay contiguous.
            starts = self.block_starts(space)
            if size:
                lengths = np.diff(np.append(starts, size))
                is_kept = np.repeat(np.logical_or.reduceat(is_kept, starts), lengths)
            target = np.arange(size) + space * SPACE
            count = int(is_kept.sum())
            target[is_kept] = (TAPE + space) * SPACE + np.arange(count)
            self.sizes[TAPE + space] = count
            moved[space] = target
        self.rename(moved)

    def block_starts(self, space: int) -> np.ndarray:
        """Return the beginnings of contiguous values in `space`, in order."""
        return np.array(self._blocks.get(space, [0]))

    def rename(self, moved: dict[int, np.ndarray]) -> None:
        """Replace every address of the spaces in `moved` by the one at its offset there."""
        sizes = {space: len(target) for space, target in moved.items()}
        numbering = Numbering(sizes)
        targets = np.concatenate([*moved.values(), [0]])
        is_moved = np.zeros(len(SPACES) + 1, bool)
        is_moved[list(moved)] = True
        # All at once: there are thousands of small arrays.
        before = [*self.inputs, *self.outputs]
        for operation in self.operations:
            before += [*operation.inputs, operation.output]
        addresses = np.concatenate([some.ravel() for some in before])
        is_inside = is_moved[addresses // SPACE]
        addresses[is_inside] = targets[numbering.of(addresses[is_inside])]
        ends = np.cumsum([some.size for some in before])
        parts = np.split(addresses, ends[:-1])
        after = iter([part.reshape(some.shape) for part, some in zip(parts, before, strict=True)])
        self.inputs = list(islice(after, len(self.inputs)))
        self.outputs = list(islice(after, len(self.outputs)))
        operations = []
        for operation in self.operations:
            inputs = tuple(islice(after, len(operation.inputs)))
            operations.append(replace(operation, inputs=inputs, output=next(after)))
        self.operations = operations
