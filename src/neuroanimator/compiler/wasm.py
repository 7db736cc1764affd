"""A C program becomes a WebAssembly module that imports nothing, by the Zig compiler that PyPI has."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.compiler.build import CompilerError, build_folder, succeeds
from neuroanimator.compiler.zig import zig_cc, zig_folders
from neuroanimator.errors import ResourceError
from neuroanimator.storage.private_folder import kept_folder, private_folders

STACK = 4 << 20
"""Room for the arrays of functions [bytes]; what needs more ends with a trap, not with wrong numbers."""

PATIENCE = 600
"""Time the compiler may take [s]: the first time on a machine it builds its own library, too."""

FLAGS = (
    "-target", "wasm32-wasi", "-mexec-model=reactor", "-std=c99", "-O2", "-msimd128", "-fno-math-errno",
    "-Wl,--no-entry", "-Wl,--strip-all", f"-Wl,-z,stack-size={STACK}", "-Wl,--export=__heap_base",
)  # fmt: skip
"""Vectors of four floats. Zig puts the stack first in memory, so that it cannot grow into other numbers."""


def wasm_module(text: str, exports: list[str]) -> bytes:
    """Return the module of the C program `text`, whose functions and variables `exports` can be called and read.

    Raises ResourceError without Zig, and CompilerError where it fails.
    """
    zig = zig_cc()
    if zig is None:
        raise ResourceError(
            "A WebAssembly module is made by the Zig compiler. Install it with: pip install 'neuroanimator[wasm]'"
        )
    for folder in private_folders("wasm"):
        return _built(text, exports, zig, folder)
    raise ResourceError("There is no folder to compile in that nobody else can write to.")


def _built(text: str, exports: list[str], zig: list[str], folder: Path) -> bytes:
    with build_folder(folder) as work_folder:
        source = work_folder / "program.c"
        module = work_folder / "program.wasm"
        source.write_text(text, encoding="utf-8")
        wanted = [f"-Wl,--export={name}" for name in exports]
        command = [*zig, *FLAGS, *wanted, str(source), "-o", str(module)]
        # What Zig builds of its own library is worth keeping; the home folder may be missing.
        caches = zig_folders(kept_folder("zig") or work_folder, work_folder)
        if not succeeds(command, work_folder, PATIENCE, caches) or not module.is_file():
            raise CompilerError("the Zig compiler failed")
        return module.read_bytes()
