"""How many processor cores this process may use."""

from __future__ import annotations

import os


def core_count() -> int:
    """Return how many processor cores this process may run on: a container or `taskset` may allow fewer than there are."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
