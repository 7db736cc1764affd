"""Memory that generated C works in, kept from call to call."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.kept import aligned


class WorkspacePool:
    """Workspaces of one size, each lent to one call at a time: threads get their own."""

    def __init__(self, size: int):
        self._size = size
        self._free: list[Float[np.ndarray, " N"]] = []

    @contextmanager
    def acquire(self) -> Iterator[int]:
        """Yield the address of `size` floats, aligned for the widest register."""
        try:
            workspace = self._free.pop()
        except IndexError:
            workspace = aligned(np.zeros(self._size, np.float32))
        try:
            yield workspace.ctypes.data
        finally:
            self._free.append(workspace)
