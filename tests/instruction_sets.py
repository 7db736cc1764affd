"""Which vector instructions the tests compute with: this machine's, or fewer, as on an older one.

    python tests/instruction_sets.py               the names of those that have fewer than this machine, a line each
    INSTRUCTION_SET=avx2 .venv/bin/pytest tests    the tests with one of them

Last bits differ between them, and no verdict may hang on those. MuJoCo's own library has one set, which every machine has.
"""

from __future__ import annotations

import os
from pathlib import Path

SWITCH = "INSTRUCTION_SET"
"""Environment variable that names one of those below; this machine's own if it is empty."""

FEWER: dict[str, dict[str, str]] = {
    "avx2": {
        "XLA_FLAGS": "--xla_cpu_max_isa=AVX2",
        "CC": "cc -mno-avx512f",
        "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
        "OPENBLAS_CORETYPE": "Haswell",
    },
    "sse4": {
        "XLA_FLAGS": "--xla_cpu_max_isa=SSE4_2",
        "CC": "cc -mno-avx",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
        "OPENBLAS_CORETYPE": "Nehalem",
    },
}
"""Environment of each: settings of JAX, of the compiler of generated C, of NumPy and of its matrix products."""

NEEDS = {"avx2": "avx512f", "sse4": "avx2"}
"""Instructions that a machine has if it has more than the set does."""


def choose_instruction_set() -> None:
    """Set the environment of the set that is asked for; before NumPy and JAX are imported."""
    name = os.environ.get(SWITCH, "")
    if not name:
        return
    for variable, value in FEWER[name].items():
        if variable == "XLA_FLAGS":
            value = f"{os.environ.get(variable, '')} {value}".strip()
        os.environ[variable] = value


def fewer_than_here() -> list[str]:
    """Return the names of the sets that have fewer instructions than this machine; none where it does not say."""
    about = Path("/proc/cpuinfo")
    known = set(about.read_text().split()) if about.exists() else set()
    return [name for name, needed in NEEDS.items() if needed in known]


if __name__ == "__main__":
    print("\n".join(fewer_than_here()))
