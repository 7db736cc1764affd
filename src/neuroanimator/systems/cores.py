"""How many processor cores this process may use."""

from __future__ import annotations

import os

CORES = "NEUROANIMATOR_CORES"
"""The environment variable that says how many cores a process may use: that of a worker among several."""


def core_count() -> int:
    """Return how many processor cores this process may run on: a container or `taskset` may allow fewer than there are."""
    stated = os.environ.get(CORES, "")
    if stated.isdecimal() and int(stated) > 0:
        return int(stated)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
