"""Opened datasets: read into memory if they fit, otherwise left on disk and read a shard at a time.

Shards are read, not mapped into memory: each is checked against its sha256 whenever it is read, and must not change
after the check.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.files.places import Place
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.store import Dataset, StoredTransitions, Transitions, join_transitions
from neuroanimator.systems.system import System

COPIES = 5
"""Number of copies of a dataset's windows in memory while an emulator is made for it: they are gathered, split into
training and validation sets, encoded, and handed to JAX."""

DEFAULT_MEMORY = 8 * 10**9
"""Default memory for a dataset [bytes]: the usual dataset of every system that ships fits."""

NUMBER_SIZE = 4
"""Size of a number in shards and networks [bytes]."""

STEPS_AT_ONCE = 4096
"""Number of super steps summed at a time, across shard boundaries: sums are the same to the bit however much is in memory."""


def open_transitions(
    folder: str | Place, memory: int = DEFAULT_MEMORY
) -> Transitions | StoredTransitions:
    """Return the dataset in `folder`, read into memory if it and its copies fit into `memory` [bytes].

    Recordings are always read: they were in memory when their dataset was made. Raises BadFileError as
    `read_transitions` does; for a dataset that stays on disk, when its shards are read.
    """
    data = StoredTransitions.at(folder)
    if data.system.recordings is not None or memory_taken(data.config, data.system) <= memory:
        return data.joined(data.part_count)
    return data


def open_to_measure(folder: str | Place) -> Transitions | StoredTransitions:
    """Return the dataset in `folder` with one shard at a time in memory; recordings are read whole.

    Everything is read once, so that BadFileError for a missing or damaged shard is raised at once.
    """
    data = open_transitions(folder, memory=0)
    if isinstance(data, StoredTransitions):
        for _ in data.parts(unroll=1):
            pass
    return data


def recut(parts: Iterable[Transitions], size: int) -> Iterator[Transitions]:
    """Yield the windows of `parts` in order, `size` at a time across their boundaries; the last batch may be smaller."""
    gathered: list[Transitions] = []
    count = 0
    for part in parts:
        gathered.append(part)
        count += len(part.states)
        if count < size:
            continue
        pieces = _pieces_of(join_transitions(gathered), size)
        left = count % size
        gathered = [part.where(slice(len(part.states) - left, None))]
        count = left
        yield from pieces
    if count:
        yield join_transitions(gathered)


def _pieces_of(windows: Transitions, size: int) -> Iterator[Transitions]:
    """Yield the whole pieces of `size` windows that there are."""
    for last in range(size, len(windows.states) + 1, size):
        yield windows.where(slice(last - size, last))


class SuperSteps(NamedTuple):
    """Super steps one by one: states, the controls applied there, the states a super step later."""

    states: Float[np.ndarray, "N S"]
    controls: Float[np.ndarray, "N C"]
    next_states: Float[np.ndarray, "N S"]


def super_steps(data: Dataset) -> Iterator[SuperSteps]:
    """Yield all training examples of `data` in order, `STEPS_AT_ONCE` at a time; the last batch may be smaller."""
    for windows in recut(data.parts(unroll=1), STEPS_AT_ONCE):
        yield SuperSteps(windows.states[:, 0], windows.controls[:, 0], windows.states[:, 1])


def first_windows(data: Dataset, count: int) -> Transitions:
    """Return the first `count` windows of `data`, or all if there are fewer; no more are read."""
    return next(recut(data.parts(), count))


def memory_taken(config: DatasetConfig, system: System) -> int:
    """Return the memory that training on this dataset takes if all of it is read [bytes]."""
    windows = config.runs * config.samples_per_run
    return windows * memory_per_window(system.state.size, system.control.size, system.window_steps)


def memory_per_window(state_size: int, control_size: int, steps: int) -> int:
    """Return the memory that training takes for each window of `steps` super steps, copies included [bytes]."""
    numbers = (steps + 1) * state_size + steps * control_size
    return COPIES * NUMBER_SIZE * numbers
