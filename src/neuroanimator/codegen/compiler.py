"""The machine's own C compiler, if there is one, and the libraries it has compiled.

A compiled program is executable code, so it is stored where nobody else can write, is written whole, and is loaded only
if its content is unchanged: its sha256 is part of its name. If any of this fails there is no library, and callers go on
without C.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
from functools import cache
from pathlib import Path

from neuroanimator.codegen.build import (
    CompilerError,
    NoCompilerError,
    build_library,
    compiler_version,
)
from neuroanimator.codegen.cores import processor_facts
from neuroanimator.codegen.zig import zig_cc
from neuroanimator.files.private_folder import private_folders
from neuroanimator.files.unfinished import replace_together
from neuroanimator.terminal import warn_once

COMPILERS = ("cc", "gcc", "clang")
"""Commands to look for, in this order."""

HOW_TO_GET_ONE = "install gcc or clang, or: pip install 'neuroanimator[compiler]'"
"""Advice for machines without a C compiler."""

FLAGS = (
    ("-O3", "-march=native", "-ffast-math", "-mprefer-vector-width=512"),
    ("-O3", "-march=native", "-ffast-math"),
    ("-O3", "-ffast-math"),
)
"""Sets of flags; the first that the compiler knows is used."""

_given_up: dict[str, CompilerError | OSError] = {}
"""The last fault of each compiler. After a `NoCompilerError` this process does not try it again: one that hangs would do so for
every program."""

PURPOSE = "compiled"
"""Name of the libraries' private folder."""

KEY_DIGITS = 24
"""Number of sha256 digits that identify a program and its compiler: collisions do not happen."""


FlagSets = tuple[tuple[str, ...], ...]


def compiled_library(text: str, flag_sets: FlagSets = FLAGS) -> ctypes.CDLL | None:
    """Return the library of the C program `text`, compiled with the first of `flag_sets` that the compiler knows.

    None without a compiler, or if it fails, which is reported once.
    """
    compiler = find_compiler()
    if compiler is None:
        return None
    return _compiled(text, compiler, flag_sets)


def obstacle() -> str | None:
    """Return why `compiled_library` failed; None if the compiler rejected the program."""
    fault = _given_up.get(find_compiler() or "")
    return None if type(fault) is CompilerError else _reason(fault)


def _reason(fault: CompilerError | OSError | None) -> str:
    return str(getattr(fault, "strerror", None) or fault)


def compiler_facts() -> str | None:
    """Return what compiled code depends on besides its text: compiler, version and processor; None without a compiler."""
    compiler = find_compiler()
    if compiler is None or isinstance(_given_up.get(compiler), NoCompilerError):
        return None
    try:
        version = compiler_version(*shlex.split(compiler))
    except NoCompilerError as error:
        _give_up(compiler, error)
        return None
    processor = processor_facts("flags", "Features")  # -march=native depends on them
    return "\n".join([compiler, version, platform.machine(), *processor])


def find_compiler() -> str | None:
    """Return the command of a C compiler; None if there is none, or one without the flags above (Windows).

    `$CC` is used if set, with its arguments; next the machine's own, and then the one of the extra `[compiler]`.
    """
    if os.name != "posix":
        return None
    asked = os.environ.get("CC", "").strip()
    if not asked:
        return _machines_own() or _zig()
    try:
        program = shutil.which(shlex.split(asked)[0])
    except ValueError:  # an unmatched quotation mark
        program = None
    if program is None:
        warn_once(f"CC={asked}: no such program, so nothing is compiled. JAX is used instead of C.")
        return None
    return asked


def _machines_own() -> str | None:
    paths = [path for path in map(shutil.which, COMPILERS) if path]
    return shlex.quote(paths[0]) if paths else None


def _zig() -> str | None:
    command = zig_cc()
    return None if command is None else shlex.join(command)


@cache
def _compiled(text: str, compiler: str, flag_sets: FlagSets) -> ctypes.CDLL | None:
    """Return the library of the program `text`, made once per processor and compiler; None if that fails."""
    facts = compiler_facts()
    if facts is None:
        return None
    key = hashlib.sha256("\n".join([text, facts, str(flag_sets)]).encode()).hexdigest()
    try:
        return _found_or_made(text, shlex.split(compiler), flag_sets, key[:KEY_DIGITS])
    except (CompilerError, OSError) as error:
        _give_up(compiler, error)
        return None


def _give_up(compiler: str, error: CompilerError | OSError) -> None:
    """Report once why nothing could be compiled."""
    _given_up[compiler] = error
    warn_once(f"Nothing could be compiled ({_reason(error)}). JAX is used instead of C.")


def _found_or_made(text: str, command: list[str], flag_sets: FlagSets, key: str) -> ctypes.CDLL:
    """Return the library `key`; OSError if it can be loaded from no folder, CompilerError if it cannot be made."""
    fault: CompilerError | OSError = OSError(0, "there is no folder that only you can write to")
    for folder in private_folders(PURPOSE):
        if os.statvfs(folder).f_flag & getattr(os, "ST_NOEXEC", 0):
            fault = OSError(0, f"programs may not be run from {folder}")
            continue
        try:
            found = _found(folder, key)
            return found or ctypes.CDLL(str(_make(text, command, flag_sets, folder, key)))
        except NoCompilerError:
            raise
        except (CompilerError, OSError) as error:  # this folder may be full
            fault = error
    raise fault


def _found(folder: Path, key: str) -> ctypes.CDLL | None:
    """Return the library `key` from `folder`; a library that is damaged, or cannot be loaded, is removed."""
    for path in folder.glob(f"{key}-*.so"):
        try:
            if path == _path(folder, key, path.read_bytes()):
                return ctypes.CDLL(str(path))
        except OSError:  # made for another kind of machine, or unreadable
            pass
        path.unlink(missing_ok=True)
    return None


def _make(text: str, command: list[str], flag_sets: FlagSets, folder: Path, key: str) -> Path:
    """Compile `text` to a library in `folder` and return its path: written whole, and named by its content."""
    content = build_library(text, command, flag_sets, folder)
    path = _path(folder, key, content)
    replace_together({path: content})
    return path


def _path(folder: Path, key: str, content: bytes) -> Path:
    return folder / f"{key}-{hashlib.sha256(content).hexdigest()}.so"
