"""Compile a C program to a WebAssembly module without imports, with the Zig compiler from PyPI."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from neuroanimator.codegen.build import succeeds
from neuroanimator.codegen.zig import zig_cc, zig_folders
from neuroanimator.errors import NeuroAnimatorError, ResourceError
from neuroanimator.files.private_folder import kept_folder, private_folders
from neuroanimator.files.unfinished import temporary_folder

STACK = 4 << 20
"""Size of the stack for functions' arrays [bytes]; an overflow traps instead of giving wrong numbers."""

PATIENCE = 600
"""Maximum time of a compilation [s]: the first on a machine may build Zig's own library, too."""

FLAGS = (
    "-std=c99", "-O2", "-fno-math-errno",
    "-Wl,--no-entry", "-Wl,--strip-all", f"-Wl,-z,stack-size={STACK}", "-Wl,--export=__heap_base",
)  # fmt: skip
"""Flags of compiler and linker; Zig puts the stack first in memory, so that it cannot grow into other data."""

BARE = ("-target", "wasm32-freestanding", "-mcpu=generic+bulk_memory+simd128", "-nostdlib")
"""Target without a C library, which Zig would take half a minute to build, and with vectors of four floats."""

WITH_LIBRARY = ("-target", "wasm32-wasi", "-mexec-model=reactor", "-msimd128")

INSTRUCTIONS = {
    "math.h": (
        "fabs", "sqrt", "rint", "fabsf", "sqrtf", "floorf", "ceilf", "rintf", "copysignf", "isnan", "isinf", "isfinite",
    ),
    "string.h": ("memcpy", "memmove", "memset"),
}  # fmt: skip
"""Functions of C's headers that programs may call, as WebAssembly has instructions for them."""


def wasm_module(text: str, name: str, exports: Sequence[str]) -> bytes:
    """Return the module `name` of the C program `text`: its functions and variables called `name_` and one of `exports`.

    Raises ResourceError without Zig, and NeuroAnimatorError if it fails.
    """
    zig = zig_cc()
    if zig is None:
        raise ResourceError(
            "A WebAssembly module is made by the Zig compiler. Install it with: pip install 'neuroanimator[wasm]'"
        )
    for folder in private_folders("wasm"):
        return _built(text, name, exports, zig, folder)
    raise ResourceError(
        "No folder to compile in that only you can write to. Set XDG_CACHE_HOME to one."
    )


def _built(text: str, name: str, exports: Sequence[str], zig: list[str], folder: Path) -> bytes:
    with temporary_folder(folder) as work_folder:
        source = work_folder / "program.c"
        module = work_folder / "program.wasm"
        source.write_text(text, encoding="utf-8")
        wanted = [f"-Wl,--export={name}_{export}" for export in exports]
        bare = (*BARE, "-isystem", str(_bare_headers(work_folder)))
        # Zig's own library is worth keeping; the home folder may be missing.
        caches = zig_folders(kept_folder("zig") or work_folder, work_folder)
        # Programs that call functions without instructions do not compile without a library.
        for target in (bare, WITH_LIBRARY):
            command = [*zig, *target, *FLAGS, *wanted, str(source), "-o", str(module)]
            if succeeds(command, work_folder, PATIENCE, caches) and module.is_file():
                return module.read_bytes()
    raise NeuroAnimatorError(f"{name}.wasm: the Zig compiler failed. Please report it.")


def _bare_headers(work_folder: Path) -> Path:
    """Write headers that map functions to the compiler's builtins, and return their folder."""
    folder = work_folder / "include"
    folder.mkdir()
    for header, names in INSTRUCTIONS.items():
        lines = [f"#define {name} __builtin_{name}\n" for name in names]
        if header == "math.h":
            lines += ["#define INFINITY __builtin_inff()\n", '#define NAN __builtin_nanf("")\n']
        (folder / header).write_text("".join(lines), encoding="utf-8")
    return folder
