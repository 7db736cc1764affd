"""The array type of code that is written once for NumPy and for JAX."""

from __future__ import annotations

from typing import Any

AnyArray = Any
"""An array of NumPy or of JAX: used as `Float[AnyArray, "*B 4"]`, of which the shape and the
dtype are checked, while the library the array comes from is left open."""
