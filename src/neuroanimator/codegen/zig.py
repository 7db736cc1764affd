"""The Zig compiler from PyPI: it makes WebAssembly, and is the C compiler on machines without one."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

PACKAGE = "ziglang"
"""Name of the PyPI package, in the extras `[compiler]` and `[wasm]`."""


def zig_cc() -> list[str] | None:
    """Return the command of Zig's C compiler; None if the package is not installed."""
    spec = importlib.util.find_spec(PACKAGE)
    if spec is None or spec.origin is None:
        return None
    # Not `python -m`: that would run a package of this name in the current folder.
    program = shutil.which(str(Path(spec.origin).with_name("zig")))
    return None if program is None else [program, "cc"]


def zig_folders(kept: Path, work_folder: Path) -> dict[str, str]:
    """Return the environment variables that make Zig keep its own libraries in `kept` and all else in `work_folder`."""
    return {
        "ZIG_GLOBAL_CACHE_DIR": str(kept),
        "ZIG_LOCAL_CACHE_DIR": str(work_folder / "cache"),
    }
