"""Settings of JAX: products of matrices in float32 on GPUs, and a folder that keeps compiled programs.

With that folder, only the first run on a machine waits for the compiler. It is the user's own, and of one processor
and one version of JAX: what is in it is machine code (docs/decisions/0014-compiled-once-a-machine.md).
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

from neuroanimator.files.private_folder import kept_folder

SWITCH = "NEUROANIMATOR_CACHE"
"""Environment variable that switches the folder off."""

OFF = ("off", "0", "no", "false")
"""Values of that variable that do so."""

MAX_PROGRAMS = 12_000
"""Maximum number of programs kept on disk, beyond which half of them is removed: about 200 MB, four times what the tests make."""

COMPLAINTS = "Error (reading|writing) persistent compilation cache entry"
"""Pattern of JAX's warnings where a kept program is damaged or the disk is full: it compiles instead."""

UNOPTIMISED: dict[str, bool | int] = {"xla_backend_optimization_level": 0}
"""Options of XLA with which it compiles in a fifth of the time."""

# Later versions have no such option, and refuse it.
if jax.__version_info__ < (0, 11):
    UNOPTIMISED["xla_cpu_use_fusion_emitters"] = False

GPU_PLUGINS = "jax_plugins"
"""Package in which JAX finds what drives GPUs; there is none where it was installed for processors alone."""


def keep_float32() -> None:
    """Let products of matrices on a GPU be those of float32, unless the user has said something else.

    JAX rounds their factors to ten bits there by default (TF32), by up to a two-thousandth; no processor does.
    """
    if find_spec(GPU_PLUGINS) is None:
        return  # and so programs that are kept on disk stay what they are
    if jax.config.jax_default_matmul_precision is None:
        jax.config.update("jax_default_matmul_precision", "highest")


keep_float32()


@cache
def keep_programs() -> Path | None:
    """Keep what JAX compiles from now on, and return the folder; None where that is off, or left to the user.

    Where no folder can be had (no home, a read-only disk) everything works as without.
    """
    if os.environ.get(SWITCH, "").lower() in OFF or jax.config.jax_compilation_cache_dir:
        return None
    folder = kept_folder("programs", _machine())
    if folder is None:
        return None
    _remove_unused_half(folder)
    warnings.filterwarnings("ignore", message=COMPLAINTS)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # Hundreds of small programs take longer to compile than to read.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return folder


def compiled_quickly(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` compiled by JAX without optimising it, for what runs once."""
    return jax.jit(function, compiler_options=UNOPTIMISED)


def _machine() -> str:
    """Return a name for what machine code depends on: the processor and its features, JAX and its compiler."""
    facts = [
        platform.system(),
        platform.machine(),
        platform.processor(),
        version("jax"),
        version("jaxlib"),
    ]
    about = Path("/proc/cpuinfo")
    lines: list[str] = []
    if about.exists():
        lines = about.read_text().splitlines()
    for key in ("model name", "flags", "Features", "CPU part"):
        facts += [line for line in lines if line.startswith(key)][:1]
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:16]


def _remove_unused_half(folder: Path) -> None:
    """Remove half of the programs in `folder` if there are too many: those that were read, or written, longest ago."""
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
    """Return when a program was read or written last, as far as the disk keeps that: to a day, or of writing alone."""
    status = entry.stat()
    return max(status.st_mtime, status.st_atime)
