"""Generated programs with their numbers: compiled once per machine, checked against JAX before their first use, then kept.

A record on disk states that a program agreed with JAX there. It is stored where nobody else can write, is whole or absent,
and is read only if its checksum is right.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.compiler import compiled_library, compiler_facts
from neuroanimator.codegen.program import aligned_zeros
from neuroanimator.codegen.trace import TooLongError, UnsupportedError
from neuroanimator.errors import BadFileError, NeuroAnimatorError
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.files.private_folder import kept_folder
from neuroanimator.terminal import phase, warn_once

OPTIMISED = (
    "-O1",
    "-ftree-vectorize",
    "-fpeel-loops",
    "-fexpensive-optimizations",
    "-ffp-contract=fast",
    "-fno-math-errno",
)
"""NaN is preserved, unlike with -ffast-math. Short loops are unrolled, and multiply-adds found. With -O2 programs
take half as long again to compile, and those of sixteen lanes are slower."""

FLAGS = (
    (*OPTIMISED, "-fno-trapping-math", "-march=native", "-mprefer-vector-width=512"),
    (*OPTIMISED, "-fno-trapping-math", "-march=native"),
    OPTIMISED,
)
"""Sets of compiler flags; the first that the compiler knows is used."""

SOURCES = ("codegen", "emulator", "state", "control", "animation", "export", "learn", "gym")
"""Folders of the package whose code determines what programs do: when it changes, programs are made anew."""


def has_code_in_sources(thing: Any) -> bool:
    """Return whether the code of an object's class is in `SOURCES`: the class's name then determines what it computes."""
    return type(thing).__module__.startswith(
        tuple(f"neuroanimator.{folder}." for folder in SOURCES)
    )


SUFFIXES = (".py", ".c", ".h")
"""Suffixes of files with code."""

RECORD = "program"
"""Kind of file that a record is."""

Reference = TypeVar("Reference")
"""Reference values for a program, computed by JAX."""


class WrongProgramError(NeuroAnimatorError):
    """A program whose results differ from JAX's."""


@dataclass(frozen=True, eq=False)
class CProgram:
    """Text of a program and the numbers it reads."""

    text: str
    constants: Float[np.ndarray, " K"]
    sizes: dict[str, int]
    """Sizes that callers need, such as the number of floats on a tape."""


@dataclass(frozen=True, eq=False)
class LoadedProgram:
    """A compiled program."""

    library: ctypes.CDLL
    constants: Float[np.ndarray, " K"]
    """Constants, aligned for the widest register."""
    sizes: dict[str, int]


def load_program(
    about: Callable[[], list[str]],
    make: Callable[[], CProgram],
    refer: Callable[[], Reference],
    check: Callable[[Reference, LoadedProgram], None],
    reported: str = "",
) -> LoadedProgram | None:
    """Return the program identified by the facts `about`, made by `make` and passed by `check` once on this machine.

    None without facts, if nothing can be compiled, and for operations without C and too much of it, which is reported as
    those of `reported`.
    `refer` returns the reference values, which JAX computes while the compiler works. `check` raises WrongProgramError for a
    program that differs: it is not kept, which is reported once.
    """
    try:
        facts = about()
        if facts:
            return _load("\n".join(facts), partial(_made_and_checked, make, refer, check))
    except WrongProgramError as error:
        warn_once(f"{error} JAX is used instead of C.")
    except (UnsupportedError, TooLongError) as error:
        if reported:
            warn_once(f"{reported}: {error} JAX is used instead of C, which is slower.")
    return None


def _load(about: str, make: Callable[[Path | None], LoadedProgram | None]) -> LoadedProgram | None:
    """Return the program with the facts `about`: loaded before, kept, or made by `make`, which keeps it in a record."""
    facts = compiler_facts()
    if facts is None:
        return None
    key = hashlib.sha256("\n".join([about, facts, str(FLAGS), sources()]).encode()).hexdigest()
    folder = kept_folder("c-programs")
    if (folder, key) in _loaded:
        return _loaded[folder, key]
    record = None if folder is None else folder / f"{key}.safetensors"
    kept = None if record is None else _read(record)
    loaded = make(record) if kept is None else _compiled(kept)
    if loaded is not None:
        _loaded[folder, key] = loaded
    return loaded


_loaded: dict[tuple[Path | None, str], LoadedProgram] = {}
"""Programs loaded by this process, by folder of records and name of record: reading one takes longer than a descent."""


def _made_and_checked(
    make: Callable[[], CProgram],
    refer: Callable[[], Reference],
    check: Callable[[Reference, LoadedProgram], None],
    record: Path | None,
) -> LoadedProgram | None:
    """Return the program of `make` once it has passed `check`, kept in `record`; None if it cannot be compiled."""
    with phase("generating C"):
        program = make()
    # The compiler is a process; this thread waits for it, and kills it if interrupted.
    with ThreadPoolExecutor(1) as pool:
        reference = pool.submit(refer)
        loaded = _compiled(program)
    if loaded is None:
        return None
    with phase("comparing C with JAX"):
        check(reference.result(), loaded)
    if record is not None:
        _write(record, program)
    return loaded


def _compiled(program: CProgram) -> LoadedProgram | None:
    with phase("compiling C"):
        library = compiled_library(program.text, FLAGS)
    if library is None:
        return None
    return LoadedProgram(library, aligned(program.constants), program.sizes)


def declared(
    library: ctypes.CDLL, name: str, parameters: int, returned: Any = ctypes.c_int
) -> Callable[..., Any]:
    """Return a library's function with `parameters` addresses and counts as arguments."""
    function = getattr(library, name)
    function.restype = returned
    function.argtypes = [ctypes.c_void_p] * parameters  # counts are as long as addresses
    return function


def address(array: np.ndarray) -> int:
    """Return the address of an array in C order; C may use it as long as the array lives."""
    if array.nbytes and array.flags.writeable:
        return ctypes.addressof(ctypes.c_char.from_buffer(array.data))  # four times as fast
    return array.ctypes.data


def aligned(numbers: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    """Return a float32 copy, aligned for the widest register."""
    result = aligned_zeros(len(numbers))
    result[:] = numbers
    return result


def _read(record: Path) -> CProgram | None:
    """Return the program in a record; None if there is none, or a damaged one."""
    try:
        tensors, metadata = read_tensors(record, RECORD)
        return CProgram(metadata["text"], tensors["constants"], metadata["sizes"])
    except (BadFileError, OSError, KeyError):
        return None


def _write(record: Path, program: CProgram) -> None:
    """Keep a program; if the disk is full, the next process makes it again."""
    metadata = {"kind": RECORD, "text": program.text, "sizes": program.sizes}
    try:
        write_tensors(record, {"constants": np.asarray(program.constants)}, metadata)
    except (OSError, NeuroAnimatorError):
        record.unlink(missing_ok=True)


@cache
def sources() -> str:
    """Return the names, sizes and times of the code files that determine what programs do."""
    package = Path(str(resources.files("neuroanimator")))
    facts = []
    for folder in SOURCES:
        for path in sorted((package / folder).rglob("*.[pch]*")):
            if path.suffix in SUFFIXES:
                status = path.stat()
                facts.append(f"{path.name} {status.st_size} {status.st_mtime_ns}")
    return "\n".join(facts)
