"""Waiting for other processes and threads, however slow or busy the machine is."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE = 600.0
"""Time after which a test takes what it waits for as lost [s]: only a failure takes that long, so that no load does."""


def wait_until(is_so: Callable[[], object], every: float = 0.01) -> None:
    """Return once `is_so` returns something true; it is asked `every` so many seconds."""
    given_up = time.monotonic() + PATIENCE
    while not is_so():
        assert time.monotonic() < given_up, "waited in vain"
        time.sleep(every)
