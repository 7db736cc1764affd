"""Placement of a program's values in memory: the room of values no longer read is given to later ones.

This keeps the working set of a super step in the first-level cache, also with sixteen lanes.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Sequence

import numpy as np

from neuroanimator.codegen.program import SPACE, Addresses, Operation, Program, spaces_of

ALWAYS = np.iinfo(np.int64).max
"""Number of the last operation to read an output: after all others."""


def placed(
    program: Program,
    operations: Sequence[Operation],
    inputs: Sequence[Addresses],
    outputs: Sequence[Addresses],
    spaces: Sequence[int],
) -> Program:
    """Return the program of `operations` alone, in order, with its values packed into the least room found in `spaces`.

    Each value stays contiguous and aligned. `inputs` live from the start, `outputs` to the end.
    """
    moved = {}
    sizes = {}
    for space in spaces:
        if space in program.sizes:
            starts = program.block_starts(space)
            written, read = _lives(space, starts, operations, inputs, outputs)
            lengths = np.diff(np.append(starts, program.sizes[space]))
            places, sizes[space] = _places(written, read, lengths)
            offsets = np.arange(program.sizes[space]) - np.repeat(starts, lengths)
            moved[space] = space * SPACE + np.repeat(places, lengths) + offsets
    part = Program(program.constants, list(inputs), list(outputs), list(operations), sizes)
    part.rename(moved)
    return part


def _lives(
    space: int,
    starts: np.ndarray,
    operations: Sequence[Operation],
    inputs: Sequence[Addresses],
    outputs: Sequence[Addresses],
) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each value of a space, the first operation that writes it and the last that reads it; -1 is before all."""
    first = np.full(len(starts), ALWAYS)
    last = np.full(len(starts), -1)

    def values_at(addresses: Addresses) -> np.ndarray:
        inside = addresses[(addresses >= 0) & (spaces_of(addresses) == space)] % SPACE
        return np.searchsorted(starts, inside, side="right") - 1

    for addresses in inputs:
        first[values_at(addresses)] = -1
    for number, operation in enumerate(operations):
        touched = [addresses.ravel() for addresses in (operation.output, *operation.inputs)]
        if operation.space == space:
            written = values_at(operation.output)
            first[written] = np.minimum(first[written], number)
        last[values_at(np.concatenate(touched))] = number
    for addresses in outputs:
        last[values_at(addresses)] = ALWAYS
    return first, last


def _places(written: np.ndarray, read: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, int]:
    """Return where each value begins, in the lowest gap that is free from when it is `written` to when it was last `read`,
    and the total size."""
    places = np.zeros(len(lengths), int)
    size = 0
    living: list[tuple[int, int, int]] = []  # begin, end and last reader of each value, in order
    for value in np.argsort(written, kind="stable").tolist():
        first = int(written[value])
        if first == ALWAYS:
            break  # nothing writes it
        living = [one for one in living if one[2] >= first]
        length = int(lengths[value])
        place = 0
        for begin, end, _ in living:
            if begin - place >= length:
                break
            place = end
        insort(living, (place, place + length, int(read[value])))
        places[value] = place
        size = max(size, place + length)
    return places, size
