"""The processor: what it is, how many of its cores this process may use, and work on many rows spread over them."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import TypeVar

Made = TypeVar("Made")

CORES = "NEUROANIMATOR_CORES"
"""Environment variable with the number of cores a process may use: for a worker among several."""

LANES = 16
"""Number of rows to whose multiples parts are aligned: programs of sixteen lanes then have the same neighbours in any part."""


def core_count() -> int:
    """Return the number of processor cores this process may use: a container or `taskset` may allow fewer than there are."""
    stated = os.environ.get(CORES, "")
    if stated.isdecimal() and int(stated) > 0:
        return int(stated)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor_facts(*names: str) -> list[str]:
    """Return the first line that the system tells of its processors under each of `names`; none where it tells none."""
    path = Path("/proc/cpuinfo")
    lines: list[str] = []
    if path.exists():
        lines = path.read_text(errors="replace").splitlines()
    facts = []
    for name in names:
        facts += [line for line in lines if line.startswith(name)][:1]
    return facts


def in_parts(work: Callable[[slice], Made], count: int, *, smallest: int) -> list[Made]:
    """Return the results of `work` on `count` rows in parts, one a core, each of `smallest` rows or more.

    `work` is called in threads, each time for other rows, and should release the interpreter's lock, as C does.
    """
    parts = min(core_count(), count // smallest)
    if parts < 2:
        return [work(slice(0, count))]
    length = LANES * -(-count // (LANES * parts))
    slices = [slice(first, min(first + length, count)) for first in range(0, count, length)]
    others = [_threads(parts).submit(work, some) for some in slices[1:]]
    made = [work(slices[0])]  # here: one thread fewer to wake
    return made + [other.result() for other in others]


@cache
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="rows")
