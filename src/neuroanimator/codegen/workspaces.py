"""Memory that generated C works in, kept from call to call."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.kept import aligned


class Rooms:
    """Rooms of one size, each lent to one call at a time: threads get rooms of their own."""

    def __init__(self, size: int):
        self._size = size
        self._free: list[Float[np.ndarray, " N"]] = []

    @contextmanager
    def borrowed(self) -> Iterator[int]:
        """Yield the address of `size` floats, aligned for the widest register."""
        try:
            room = self._free.pop()
        except IndexError:
            room = aligned(np.zeros(self._size, np.float32))
        try:
            yield room.ctypes.data
        finally:
            self._free.append(room)
