"""Settings of JAX: products of matrices in float32 on GPUs, and a folder that keeps compiled programs.

With that folder, only the first run on a machine waits for the compiler. It belongs to one user, one processor
and one version of JAX, as it holds machine code (docs/decisions/0014-compiled-once-a-machine.md).
`NEUROANIMATOR_CACHE=off` switches it off, and a folder of the user's own choice (`JAX_COMPILATION_CACHE_DIR`,
`jax.config`) is never replaced.
"""

from __future__ import annotations

import hashlib
import os
import platform
import warnings
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jax

from neuroanimator.codegen.cores import processor_facts
from neuroanimator.files.private_folder import kept_folder

SWITCH = "NEUROANIMATOR_CACHE"
"""Environment variable that switches the folder off."""

OFF = ("off", "0", "no", "false")
"""Values of that variable that switch it off."""

MAX_PROGRAMS = 12_000
"""Maximum number of programs kept on disk, beyond which half of them is removed: about 200 MB, four times the tests' use."""

COMPLAINTS = "Error (reading|writing) persistent compilation cache entry"
"""Pattern of JAX's warnings when a kept program is damaged or the disk is full: it compiles instead."""

UNOPTIMISED: dict[str, bool | int] = {"xla_backend_optimization_level": 0}
"""Options of XLA that make it compile in a fifth of the time."""

# Later versions lack this option and reject it.
if jax.__version_info__ < (0, 11):
    UNOPTIMISED["xla_cpu_use_fusion_emitters"] = False

GPU_PLUGINS = "jax_plugins"
"""Package in which JAX finds GPU plugins; absent if it was installed for CPUs alone."""


def keep_float32() -> None:
    """Compute matrix products on GPUs in float32, unless the user has chosen another precision.

    By default JAX rounds their factors to ten bits there (TF32), an error of up to a two-thousandth; no CPU does.
    """
    if find_spec(GPU_PLUGINS) is None:
        return  # so that programs kept on disk stay the same
    if jax.config.jax_default_matmul_precision is None:
        jax.config.update("jax_default_matmul_precision", "highest")


keep_float32()


@cache
def keep_programs() -> Path | None:
    """Keep what JAX compiles from now on, and return the folder; None if that is switched off, or left to the user.

    If no folder can be made (no home, a read-only disk), nothing is kept.
    """
    if os.environ.get(SWITCH, "").lower() in OFF or jax.config.jax_compilation_cache_dir:
        return None
    folder = kept_folder("programs", _machine())
    if folder is None:
        return None
    _remove_unused_half(folder)
    warnings.filterwarnings("ignore", message=COMPLAINTS)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # Hundreds of small programs are faster to read than to compile.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return folder


def compiled_quickly(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` compiled by JAX without optimisation, for functions that run once."""
    return jax.jit(function, compiler_options=UNOPTIMISED)


def _machine() -> str:
    """Return an identifier of what machine code depends on: the processor and its features, JAX and its compiler."""
    facts = [
        platform.system(),
        platform.machine(),
        platform.processor(),
        version("jax"),
        version("jaxlib"),
    ]
    facts += processor_facts("model name", "flags", "Features", "CPU part")
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:16]


def _remove_unused_half(folder: Path) -> None:
    """If there are too many programs in `folder`, remove the half least recently read or written."""
    try:
        entries = list(folder.iterdir())
        if len(entries) <= MAX_PROGRAMS:
            return
        entries.sort(key=_last_use)
        for entry in entries[: len(entries) // 2]:
            entry.unlink(missing_ok=True)
    except OSError:  # another process removes the same
        return


def _last_use(entry: Path) -> float:
    """Return when a program was last read or written, as far as the disk records it: to a day, or only the writing."""
    status = entry.stat()
    return max(status.st_mtime, status.st_atime)
