"""Compile a C program to a shared library, in a temporary folder, with a compiler that may fail or hang."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from neuroanimator.codegen.zig import zig_cc, zig_folders
from neuroanimator.files.unfinished import temporary_folder

PATIENCE = 120
"""Maximum processor time of a compilation [s]: the largest program takes ten on one slow core."""

LEAST_SHARE = 0.01
"""Minimum share of a core's time that a compiler at work gets, however busy the machine is; less is waiting for nothing."""

VERSION_PATIENCE = 10
"""Maximum time for a compiler to print its version [s]."""


class CompilerError(Exception):
    """The compiler rejects the program with every set of flags."""


class NoCompilerError(CompilerError):
    """The compiler is not a program, or does not end: not to be tried again."""


def build_library(
    text: str, command: list[str], flag_sets: tuple[tuple[str, ...], ...], folder: Path
) -> bytes:
    """Return the shared library of the C program `text`, built in `folder` with the first flags that the compiler knows."""
    with temporary_folder(folder) as work_folder:
        source = work_folder / "program.c"
        unlinked = work_folder / "program.o"
        library = work_folder / "program.so"
        source.write_text(text, encoding="utf-8")
        # Linked separately, without -ffast-math: with it the library would flush denormals in the whole process.
        link = [*command, "-shared", str(unlinked), "-o", str(library), _libraries(command)]
        caches = zig_folders(work_folder, work_folder)
        for flags in flag_sets:
            options = ["-std=gnu11", *flags, "-fPIC"]
            compile_ = [*command, *options, "-c", str(source), "-o", str(unlinked)]
            is_made = all(
                succeeds(line, work_folder, variables=caches) for line in (compile_, link)
            )
            if is_made and library.is_file():
                return library.read_bytes()
    raise CompilerError(f"{command[0]} failed")


def _libraries(command: list[str]) -> str:
    """Return the linker's option for libraries.

    Zig would first build its own C library, for half a minute; the process's is enough.
    """
    return "-nostdlib" if command == zig_cc() else "-lm"


@cache
def compiler_version(*command: str) -> str:
    """Return the output of `command --version`; NoCompilerError if it is not a program or does not end."""
    with _started([*command, "--version"], stdout=subprocess.PIPE) as process:
        said, _ = process.communicate(timeout=VERSION_PATIENCE)
    return said.decode(errors="replace")


def succeeds(
    command: list[str],
    work_folder: Path,
    patience: float = PATIENCE,
    variables: dict[str, str] | None = None,
) -> bool:
    """Return whether `command` succeeds in `work_folder`, with additional environment `variables`.

    Raises NoCompilerError if it cannot be started, or does not end within `patience` seconds of processor time.
    """
    # What a killed compiler leaves behind is in the temporary folder.
    surroundings = os.environ | {"TMPDIR": str(work_folder), "LC_ALL": "C"} | (variables or {})
    with _started(command, stdout=subprocess.DEVNULL, cwd=work_folder, env=surroundings) as process:
        return _ended(process, patience) == 0


def _ended(process: subprocess.Popen[bytes], patience: float) -> int:
    """Return the exit code; TimeoutExpired once all its processes have used `patience` [s], or none does anything."""
    used = 0.0
    while True:
        wait = patience - used
        try:
            return process.wait(wait)
        except subprocess.TimeoutExpired:
            before = used
            used = processor_time(process.pid)
            if used >= patience or used - before < LEAST_SHARE * wait:
                raise subprocess.TimeoutExpired(process.args, patience) from None


def processor_time(group: int) -> float:
    """Return the processor time of the processes of a group, and of those they waited for [s]; 0 where it is not told."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            # After the name, which may contain anything: state, parent, group and, from the twelfth on, the times.
            facts = path.read_text(errors="replace").rpartition(")")[2].split()
            if int(facts[2]) == group:
                ticks += sum(map(int, facts[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


@contextmanager
def _started(command: list[str], **options: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Run `command` while the block waits for it; if the block fails, kill it with all its children."""
    nothing = subprocess.DEVNULL
    try:
        process = subprocess.Popen[bytes](
            command, stdin=nothing, stderr=nothing, start_new_session=True, **options
        )
    except OSError as error:
        raise NoCompilerError(f"{command[0]}: {error.strerror}") from error
    try:
        yield process
    except BaseException as error:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if process.stdout:
            process.stdout.close()
        if isinstance(error, subprocess.TimeoutExpired):
            raise NoCompilerError(f"{command[0]} did not end within {error.timeout:g} s") from error
        raise
