"""The backend of emulators called with NumPy arrays: generated C, or JAX.

Both agree to the rounding of float32. JAX is the definition; inside `jax.jit`, `grad` and `vmap` it is always used.
"""

from __future__ import annotations

import os

from neuroanimator.codegen.compiler import HOW_TO_GET_ONE, find_compiler
from neuroanimator.errors import ArgumentError
from neuroanimator.text import printable, quoted

BACKENDS = ("auto", "c", "jax")
"""Names of backends: `auto` is C if there is a compiler and JAX otherwise; `c` fails without a compiler."""

SWITCH = "NEUROANIMATOR_BACKEND"
"""Environment variable that selects the backend."""

_chosen: list[str] = []
"""Name last given to `set_backend`, if any."""


def set_backend(name: str) -> None:
    """Use the backend `name`, one of `BACKENDS`, from now on; it takes precedence over the environment."""
    _check(name, "backend")
    _chosen[:] = [name]


def backend() -> str:
    """Return the backend in use, one of `BACKENDS`. Raises ArgumentError if the environment names another."""
    if _chosen:
        return _chosen[0]
    asked = os.environ.get(SWITCH, "").strip().lower() or "auto"
    _check(asked, SWITCH)
    return asked


def backend_in_words() -> str:
    """Return what runs emulators here, in words: the backend, and the compiler if it is C."""
    asked = backend()
    compiler = find_compiler()
    if asked == "jax":
        return f"JAX (chosen by {SWITCH} or set_backend)"
    if compiler is None:
        return f"JAX (no C compiler was found; for speed {HOW_TO_GET_ONE})"
    return f"generated C, compiled by {printable(compiler)}"


def _check(name: str, label: str) -> None:
    if name not in BACKENDS:
        raise ArgumentError(f"{label}: wanted one of {', '.join(BACKENDS)}, got {quoted(name)}.")
