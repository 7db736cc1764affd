"""The C twin of a mass-spring body: the same physics compiled for one core, the opponent of its emulators."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from neuroanimator.evaluation.c_source import c_source
from neuroanimator.systems.body import Body

INTEGRATORS = ("symplectic", "semi-implicit", "rk4")
"""In the order of the C program."""

COMPILERS = ("cc", "gcc", "clang")

FLAGS = (
    ("-O3", "-march=native", "-ffast-math", "-mprefer-vector-width=512"),
    ("-O3", "-march=native", "-ffast-math"),
    ("-O3", "-ffast-math"),
)
"""The first that the compiler knows are used."""

LANES = 16
"""Bodies side by side in a batch: one AVX-512 register of float32, two of AVX."""

PATIENCE = 300
"""[s] A compiler may take."""


@dataclass(frozen=True, eq=False)
class CTwin:
    """A body's physics in C: bodies are stepped `lanes` at a time, each on one core."""

    library: ctypes.CDLL
    size: int
    """Numbers in a state: places, speeds, contractions."""
    dtype: type[np.floating]
    lanes: int

    def play(self, start: np.ndarray, controls: np.ndarray, integrator: str, dt: float, steps: int) -> np.ndarray:
        """Return the states (T, S) after each of the controls (T, C), each held for `steps` steps of `dt` [s].

        With several lanes, start is (S, lanes), controls are (T, C, lanes) and so are the states.
        """
        start, controls = self._check(start), self._check(controls)
        states = np.empty((len(controls), *start.shape), self.dtype)
        self._call("play", (start, controls, states), len(controls), integrator, dt, steps)
        return states

    def advance(self, starts: np.ndarray, controls: np.ndarray, integrator: str, dt: float, steps: int) -> np.ndarray:
        """Return the states (B, S) `steps` steps of `dt` [s] after `starts` (B, S) under held controls (B, C)."""
        ends = np.empty((len(starts) // self.lanes, self.size, self.lanes), self.dtype)
        self.player(starts, controls, integrator, dt, steps, ends)()
        return np.moveaxis(ends, 1, 2).reshape(starts.shape)

    def player(
        self,
        starts: np.ndarray,
        controls: np.ndarray,
        integrator: str,
        dt: float,
        steps: int,
        ends: np.ndarray | None = None,
    ) -> Callable[[], None]:
        """Return a function that does what `advance` does in one call of C, into `ends`."""
        starts, controls = (self._check(self._side_by_side(each)) for each in (starts, controls))
        ends = np.empty(starts.shape, self.dtype) if ends is None else ends
        return lambda: self._call("advance", (starts, controls, ends), len(starts), integrator, dt, steps)

    def _side_by_side(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (B, X) as (B / lanes, X, lanes)."""
        return np.moveaxis(rows.reshape(-1, self.lanes, rows.shape[-1]), 1, 2)

    def _check(self, numbers: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(numbers, self.dtype)

    def _call(
        self, name: str, arrays: tuple[np.ndarray, ...], count: int, integrator: str, dt: float, steps: int
    ) -> None:
        pointers = (each.ctypes.data_as(ctypes.c_void_p) for each in arrays)
        kind = INTEGRATORS.index(integrator)
        getattr(self.library, name)(kind, ctypes.c_long(count), ctypes.c_long(steps), ctypes.c_double(dt), *pointers)


def c_twin(body: Body, dtype: type[np.floating] = np.float32, lanes: int = 1) -> CTwin | None:
    """Return the C twin of `body`, compiled at the first call; None where there is no C compiler."""
    if find_compiler() is None:
        return None
    library = compiled_library(c_source(body, "float" if dtype is np.float32 else "double", lanes))
    return library and CTwin(library, 6 * len(body.masses) + body.muscles.shape[1], dtype, lanes)


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
        source, made, library = (Path(folder) / f"twin.{suffix}" for suffix in ("c", "o", "so"))
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
