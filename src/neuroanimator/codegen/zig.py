"""The Zig compiler that PyPI has: it makes WebAssembly, and it is the C compiler where the machine has none of its own."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

PACKAGE = "ziglang"
"""The package of PyPI, in the extras `[compiler]` and `[wasm]`."""


def zig_cc() -> list[str] | None:
    """Return the command of Zig's C compiler, None where the package is not installed."""
    spec = importlib.util.find_spec(PACKAGE)
    if spec is None or spec.origin is None:
        return None
    # Not by `python -m`: that would run a package of this name that lies in the present folder.
    program = shutil.which(str(Path(spec.origin).with_name("zig")))
    return None if program is None else [program, "cc"]


def zig_folders(kept: Path, work_folder: Path) -> dict[str, str]:
    """Return the environment variables by which Zig keeps its own libraries in `kept` and all else in `work_folder`."""
    return {
        "ZIG_GLOBAL_CACHE_DIR": str(kept),
        "ZIG_LOCAL_CACHE_DIR": str(work_folder / "cache"),
    }
