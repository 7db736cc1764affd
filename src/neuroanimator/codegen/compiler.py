"""The machine's own C compiler, where there is one."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

COMPILERS = ("cc", "gcc", "clang")

FLAGS = (
    ("-O3", "-march=native", "-ffast-math", "-mprefer-vector-width=512"),
    ("-O3", "-march=native", "-ffast-math"),
    ("-O3", "-ffast-math"),
)
"""The first that the compiler knows are used."""

PATIENCE = 300
"""[s] A compiler may take."""


def compiled_library(text: str) -> ctypes.CDLL | None:
    """Return the library of the C program `text`; None without a compiler, or if it fails."""
    compiler = find_compiler()
    return None if compiler is None else _compiled(text, compiler)


def find_compiler() -> str | None:
    """Return the path of a C compiler, None where there is none (or one without the flags below: Windows)."""
    if os.name != "posix":
        return None
    return next((path for path in map(shutil.which, COMPILERS) if path), None)


@cache
def _compiled(text: str, compiler: str) -> ctypes.CDLL | None:
    """Return the library of the program `text`; compiled once for a processor and a compiler, None if that fails."""
    key = hashlib.sha256("\n".join([text, compiler, _version(compiler), _processor(), str(FLAGS)]).encode())
    path = _folder() / f"{key.hexdigest()[:24]}.so"
    if not path.exists() and not any(_compile(text, compiler, flags, path) for flags in FLAGS):
        return None
    return ctypes.CDLL(str(path))


def _compile(text: str, compiler: str, flags: tuple[str, ...], path: Path) -> bool:
    """Compile `text` to the shared library `path`; return whether that went well."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        source, made, library = (Path(folder) / f"program.{suffix}" for suffix in ("c", "o", "so"))
        source.write_text(text)
        # Linked apart, without -ffast-math: with it the library would flush small numbers in the whole process.
        calls = [
            [compiler, "-std=gnu11", *flags, "-fPIC", "-c", str(source), "-o", str(made)],
            [compiler, "-shared", str(made), "-o", str(library), "-lm"],
        ]
        for call in calls:
            if subprocess.run(call, capture_output=True, timeout=PATIENCE).returncode:
                return False
        os.replace(library, path)
    return True


def _folder() -> Path:
    """Return a folder for compiled programs that nobody else can write to."""
    folder = Path(tempfile.gettempdir()) / f"neuroanimator-c-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if found.st_uid == os.getuid() and not found.st_mode & 0o022 and folder.is_dir() and not folder.is_symlink():
        return folder
    return Path(tempfile.mkdtemp(prefix="neuroanimator-c-"))


@cache
def _version(compiler: str) -> str:
    return subprocess.run([compiler, "--version"], capture_output=True, text=True, timeout=PATIENCE).stdout


def _processor() -> str:
    """Return what -march=native depends on, as far as it can be told."""
    about = Path("/proc/cpuinfo")
    lines = about.read_text().splitlines() if about.exists() else []
    return platform.machine() + next((line for line in lines if line.startswith(("flags", "Features"))), "")
