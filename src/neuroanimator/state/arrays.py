"""The array type of code written once for NumPy and JAX."""

from __future__ import annotations

import math
from typing import Any

AnyArray = Any
"""An array of NumPy or JAX: in `Float[AnyArray, "*B 4"]` the shape and the dtype are checked, but not the array's
library."""


def as_rows(array: AnyArray) -> AnyArray:
    """Return `array` (..., K) as rows (N, K), even if K is 0: a system that nothing drives has no controls."""
    return array.reshape(math.prod(array.shape[:-1]), array.shape[-1])
