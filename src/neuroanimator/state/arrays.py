"""The array type of code that is written once for NumPy and for JAX."""

from __future__ import annotations

import math
from typing import Any

AnyArray = Any
"""An array of NumPy or of JAX: used as `Float[AnyArray, "*B 4"]`, of which the shape and the
dtype are checked, while the library the array comes from is left open."""


def as_rows(array: AnyArray) -> AnyArray:
    """Return `array` (..., K) as rows (N, K), even where K is 0: a system that nothing drives has no controls."""
    return array.reshape(math.prod(array.shape[:-1]), array.shape[-1])
